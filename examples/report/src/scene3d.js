// The map of one run: what is drawn, and what of it at a step.

import {Scene} from 'three';

import {kRampSize, rgbVariable} from './colour.js';
import {isNumber, kChi2, stateAt} from './data.js';
import {principalAxes} from './eigen.js';
import {colourUniform, dots, ellipsoids, hairlines, marker, segments} from './layers.js';

export const kLayers = ['kept', 'dropped', 'anchored', 'retired', 'odometry', 'links', 'truth', 'candidates', 'ellipsoids'];
const kMostCandidates = 512, kMostChosen = 64;  // drawn at a time

// The half axes of the 95 % ellipsoid of a position, long ones first, metres.
export function halfAxes(covariance, dimension) {
  const axes = principalAxes(covariance);
  const least = 1e-3 * Math.sqrt(axes[0].value * kChi2[dimension]);  // a flat one still has a normal
  return axes.map(({value, axis}) => {
    const size = Math.max(Math.sqrt(value * kChi2[dimension]), least);
    return axis.map((x) => x * size);
  });
}

// `centre` is taken off all positions, so that float32 is exact enough far from the origin.
export class MapScene {
  constructor(run, centre, scale) {
    this.run = run;
    this.centre = centre;
    this.scale = scale;
    this.scene = new Scene();
    this.visible = Object.fromEntries(kLayers.map((name) => [name, true]));
    this.step = run.n - 1;
    this.counts = {};  // of each layer: how many of its items are there at step k
    const many = run.n > 2500, manyLinks = run.links.from.length > 6000;
    const add = (layer) => {
      this.scene.add(layer.object);
      return layer;
    };
    const level = (i) => (isNumber(run.links.gain[i]) ? scale?.at(run.links.gain[i]) ?? -1 : -1);
    this.layers = {
      truth: add(segments(this.path('truth', run.truth), {width: many ? 1 : 1.4, order: 1, lift: -1, opacity: 0.85})),
      odometry: add(segments(this.pairs('odometry', run.chain, 'to', () => -1), {width: many ? 1.1 : 1.5, order: 2})),
      links: add(manyLinks ? hairlines(this.pairs('links', run.links, 'step', level), {order: 3, opacity: 0.7})
        : segments(this.pairs('links', run.links, 'step', level), {width: run.links.from.length > 500 ? 1.5 : 2.4, order: 3, opacity: 0.9})),
      ...Object.fromEntries(['dropped', 'anchored', 'retired'].map((state) => [state,
        add(this.posesIn(state, {size: many ? 3.2 : 5, stroke: many ? 0 : 1.2, order: 4}))])),
      kept: add(this.posesIn('kept', {size: many ? 4 : 7, order: 5, lift: 2})),
    };
    this.candidateColours = {value: []};
    this.candidates = add(segments([], {width: 2, order: 7, lift: 3, dashBelow: 0.5, capacity: kMostCandidates,
      scale: this.candidateColours}));
    this.current = add(marker({size: 17, stroke: 2.6, order: 8, lift: 6}));
    this.currentDot = add(marker({size: 6, order: 9, lift: 7}));
    this.chosenRings = add(dots(new Float32Array(3 * kMostChosen), {size: 14, stroke: 1.8, order: 8, lift: 5}));
    this.ellipsoidColour = colourUniform();
    this.ellipsoids = null;
  }

  point(position, i) {
    return [position.x[i] - this.centre[0], position.y[i] - this.centre[1], position.z[i] - this.centre[2]];
  }

  // Dots of the poses while they are in a state: from a step on by how many are drawn, until another by what the dots know.
  posesIn(state, options) {
    const positions = [], until = [], counts = this.counts[state] = new Int32Array(this.run.n);
    for (const spell of this.run.spells) {
      const p = this.point(this.run.position, spell.pose);
      if (spell.state !== state || !p.every(isNumber)) continue;
      positions.push(...p);
      until.push(spell.until);
      counts[spell.from]++;
    }
    for (let k = 1; k < this.run.n; k++) counts[k] += counts[k - 1];
    return dots(positions, {...options, until});
  }

  // Segments between poses, in ascending order of the step columns[key].
  pairs(name, columns, key, value) {
    const list = [], counts = this.counts[name] = new Int32Array(this.run.n);
    columns[key].forEach((step, i) => {
      const a = this.point(this.run.position, columns.from[i]), b = this.point(this.run.position, columns.to[i]);
      if (!a.every(isNumber) || !b.every(isNumber)) return;
      list.push([a, b, value(i)]);
      counts[Math.min(Math.max(step, 0), this.run.n - 1)]++;
    });
    for (let k = 1; k < this.run.n; k++) counts[k] += counts[k - 1];
    return list;
  }

  path(name, position) {
    const list = [], counts = this.counts[name] = new Int32Array(this.run.n);
    let last = null;
    for (let i = 0; position && i < this.run.n; i++) {
      const p = this.point(position, i);
      if (p.every(isNumber)) {
        if (last) list.push([last, p, -1]);
        last = p;
      }
      counts[i] = list.length;
    }
    return list;
  }

  setStep(step) {
    this.step = step;
    this.update();
  }

  setVisible(name, visible) {
    this.visible[name] = visible;
    this.update();
  }

  update() {
    const {run, step, visible} = this;
    if (run.n === 0) return;
    for (const [name, layer] of Object.entries(this.layers)) {
      layer.show(visible[name] ? this.counts[name][step] : 0);
      if (layer.uniforms.now) layer.uniforms.now.value = step;
    }
    const here = this.point(run.position, step);
    const known = here.every(isNumber);
    this.current.move(known ? here : null);
    this.currentDot.move(known ? here : null);
    const list = known && visible.candidates ? run.decisions.candidates?.[step] ?? [] : [];
    this.candidates.replace(list.slice(0, kMostCandidates)
      .map((candidate) => [here, this.point(run.position, candidate[0]), candidate[4] ? 1 : 0])
      .filter(([, p]) => p.every(isNumber)));
    this.showEllipsoids();
  }

  showEllipsoids() {
    if (!this.ellipsoids) return;
    let count = 0;  // those chosen one by one are there at every step
    while (count < this.ellipsoidSteps.length && this.ellipsoidSteps[count] <= this.step) count++;
    this.ellipsoids.show(this.visible.ellipsoids ? count : 0);
  }

  // Ellipsoids of every `every`-th kept pose (0: of none) and of the poses `chosen` (indices), drawn `scale` times as large.
  setEllipsoids(every, chosen, scale) {
    const {run} = this;
    const key = `${every} ${chosen.join()}`;
    if (key !== this.ellipsoidKey) {
      this.ellipsoidKey = key;
      this.ellipsoids?.dispose();
      const regular = every > 0 ? run.covariances.pose.filter((_, i) => i % every === 0 && !chosen.includes(run.covariances.pose[i])) : [];
      const poses = [...chosen.filter((i) => run.covarianceOf.has(i)), ...regular]
        .filter((i) => this.point(run.position, i).every(isNumber));
      this.ellipsoidSteps = poses.map((i) => (chosen.includes(i) ? -1 : i));
      this.ellipsoids = ellipsoids(poses.map((i) => [this.point(run.position, i), ...halfAxes(run.covarianceOf.get(i), run.dimension)]), {order: 6, colour: this.ellipsoidColour});
      this.scene.add(...this.ellipsoids.objects);
      this.setChosen(chosen);
    }
    this.ellipsoids.uniforms.scale.value = scale;
    this.showEllipsoids();
  }

  setChosen(chosen) {
    this.chosen = chosen.slice(0, kMostChosen);
    const attribute = this.chosenRings.object.geometry.attributes.position;
    this.chosen.forEach((i, k) => attribute.array.set(this.point(this.run.position, i), 3 * k));
    attribute.needsUpdate = true;
    this.chosenRings.show(this.chosen.length);
  }

  setTheme() {
    const set = (layer, name) => layer.uniforms.colour.value.set(...rgbVariable(name));
    const names = {kept: '--kept', dropped: '--dropped', anchored: '--anchored', retired: '--retired', odometry: '--odometry', links: '--no-gain', truth: '--truth'};
    for (const [name, layer] of Object.entries(this.layers)) set(layer, names[name]);
    set(this.current, '--current');
    set(this.currentDot, '--current');
    set(this.chosenRings, '--kept');
    this.ellipsoidColour.value.set(...rgbVariable('--ellipsoid'));
    const [refused, accepted] = [rgbVariable('--muted'), rgbVariable('--current')];
    this.candidateColours.value = Array.from({length: kRampSize}, (_, i) => (i < kRampSize / 2 ? refused : accepted)).flat();
  }

  // Some of the positions, all over the run.
  sample(most = 2000) {
    const stride = Math.max(1, Math.ceil(this.run.n / most)), list = [];
    for (let i = 0; i < this.run.n; i += stride) {
      const p = this.point(this.run.position, i);
      if (p.every(isNumber)) list.push(p);
    }
    return list;
  }

  // The pose nearest to a place on the screen among those there; `project` maps a point to [x, y] or null.
  pick(project, x, y, reach) {
    let best = null, least = reach;
    for (let i = 0; i <= this.step && i < this.run.n; i++) {
      const state = stateAt(this.run, i, this.step);
      if (!this.visible[state]) continue;
      const at = project(this.point(this.run.position, i));
      if (!at) continue;
      const distance = Math.hypot(at[0] - x, at[1] - y) - (state === 'kept' ? 3 : 0);
      if (distance < least) [best, least] = [i, distance];
    }
    return best;
  }
}
