// Puts the page together: the state is the slider's position, what is shown of the map, and the poses chosen.

import {cssColour, gainScale, ramp} from './colour.js';
import {align, boxOf, isNumber, readReport, shareIds, verticalAxis} from './data.js';
import {showDecision} from './decision.js';
import {fate, madeOf, titleOf} from './explain.js';
import {element, icon, integer, kIcons, number, plural} from './format.js';
import {kLayers, halfAxes, MapScene} from './scene3d.js';
import {Plots} from './plots.js';
import {showFigures, showTables} from './tables.js';
import {kKeys, Timeline} from './timeline.js';
import {View} from './view.js';

const $ = (id) => document.getElementById(id);

const kMagnifications = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];

const kLayerWords = {
  kept: ['kept', 'poses of the map'], dropped: ['dropped', 'poses left out, recovered from the kept ones around them'],
  anchored: ['found again', 'poses not kept whose chain starts anew at a kept pose'],
  retired: ['retired', 'poses that were kept for a time, until the map could do without them'],
  odometry: ['odometry', 'edges along the way; over dropped poses one edge'], links: ['links', 'edges beside the odometry, coloured by gain'],
  truth: ['truth', 'ground truth, laid over the estimate'], candidates: ['candidates', 'kept poses considered for a link at this step; solid: accepted'],
  ellipsoids: ['ellipsoids', '95 % of the position, of the poses chosen below'],
};
const kWithoutLayer = {
  truth: 'no ground truth given: pass --ground-truth', ellipsoids: 'no covariances in this run', candidates: 'no decisions in this run',
  links: 'no links in this run', dropped: 'no pose was dropped', odometry: 'no odometry edges in this run',
};

class Theme {
  constructor(onChange) {
    this.system = matchMedia('(prefers-color-scheme: dark)');
    this.onChange = onChange;
    try { this.chosen = localStorage.getItem('terse-theme'); } catch { /* files may have no storage */ }
    this.system.addEventListener('change', () => this.apply());
  }

  get name() { return this.chosen ?? (this.system.matches ? 'dark' : 'light'); }

  toggle() {
    this.chosen = this.name === 'dark' ? 'light' : 'dark';
    try { localStorage.setItem('terse-theme', this.chosen); } catch { /* as above */ }
    this.apply();
  }

  apply() {
    document.documentElement.dataset.theme = this.name;
    this.onChange(this.name);
  }
}

class Page {
  constructor(report) {
    this.runs = report.runs;
    this.several = this.runs.length > 1;
    this.alignment = align(this.runs, this.several && !shareIds(this.runs) ? 'share' : 'id');
    this.chosen = this.runs.map(() => []);
    this.words(report);
    showFigures($('figures'), this.runs);
    showTables($('tables'), this.runs);
    document.body.classList.toggle('compare', this.several);
    this.panels = this.runs.map(() => element('div', {class: 'card decision'}));
    $('decisions').append(...this.panels);

    const events = this.runs.flatMap((run, r) => this.positionsOfLinks(run, r));
    this.timeline = new Timeline($('player'), this.alignment.count, [...new Set(events)].sort((a, b) => a - b), this.lastChange(), () => this.showStep());
    this.timeline.label = (position) => this.label(position);
    if (this.several) this.timeline.extra.append(this.alignmentChoice());
    this.plots = new Plots($('plots'), this.runs, (position) => this.timeline.jump(position));
    this.startMap();
    this.layerChips();
    this.ellipsoidControls();
    this.theme = new Theme((name) => this.setTheme(name));
    this.theme.apply();
    this.plots.position = this.timeline.position;
    this.plots.build(this.alignment);
    this.keys();
    this.showStep();
    this.timeline.refresh();
  }

  words(report) {
    const {runs} = this;
    const names = runs.map((run) => run.name).join(' and ');
    document.title = runs.length === 1 ? `${names}: ${titleOf(runs[0]).short} · Terse report` : `${names} compared · Terse report`;
    $('title').textContent = names;
    const legend = 'Positions are the final estimates; the slider replays what was decided when.';
    $('subtitle').textContent = `${runs.map((run) => `${runs.length > 1 ? `${run.name} ` : `${String(run.stats.strategy ?? 'The run').toUpperCase()} `}${titleOf(run).long}.`).join(' ')} ${legend}`;
    $('foot').textContent = `Written by terse ${report.version ?? ''}. Lengths in metres, gains in nats.`;
  }

  positionsOfLinks(run, r) {
    const has = new Set(run.links.step);
    const out = [];
    let last = -1;
    this.alignment.indices[r].forEach((k, position) => {
      let hit = false;
      for (let i = last + 1; i <= k; i++) hit ||= has.has(i);
      if (hit) out.push(position);
      last = Math.max(last, k);
    });
    return out;
  }

  // The position at which the last kept pose of every run has come in, and the last one retired: from there on the maps do
  // not change.
  lastChange() {
    return this.runs.reduce((position, run, r) => Math.max(position, this.alignment.indices[r].findIndex((k) => k >= run.lastChange)), 0);
  }

  label(position) {
    const {pace, count, mode, indices} = this.alignment;
    const step = `${integer(position + 1)}\u202f/\u202f${integer(count)}`;
    if (this.several && mode === 'share') return [`${number((100 * (position + 1)) / count, 3)}\u202f%`, ' of the run'];
    const k = indices[this.runs.indexOf(pace)][position];
    return [`step ${step}`, ` · ${pace.id[k] === undefined ? 'no pose' : `pose ${pace.id[k]}`}`];
  }

  alignmentChoice() {
    const choice = element('select', {'aria-label': 'How the runs are aligned', title: 'How the runs are aligned'},
      [['id', 'by id'], ['share', 'by share']].map(([mode, label]) => element('option', {value: mode, selected: this.alignment.mode === mode}, label)));
    choice.addEventListener('change', () => {
      this.alignment = align(this.runs, choice.value);
      this.timeline.events = [...new Set(this.runs.flatMap((run, r) => this.positionsOfLinks(run, r)))].sort((a, b) => a - b);
      this.plots.build(this.alignment);
      this.showStep();
      this.timeline.refresh();
    });
    return choice;
  }

  startMap() {
    const box = boxOf(this.runs);
    const centre = box.min.map((x, k) => 0.5 * (x + box.max[k]));
    const local = {min: box.min.map((x, k) => x - centre[k]), max: box.max.map((x, k) => x - centre[k])};
    this.extent = Math.hypot(...local.max.map((x, k) => x - local.min[k]));
    this.scale = gainScale(this.runs);
    this.maps = this.runs.map((run) => new MapScene(run, centre, this.scale));
    $('canvas').setAttribute('aria-label', `Map of ${this.runs.map((run) => `${run.name}: ${titleOf(run).short}`).join('; ')}`);
    const flat = this.runs.every((run) => run.dimension === 2);
    try {
      this.view = new View($('canvas'), this.maps, local, flat ? {axis: 2, up: [0, 0, 1], north: [0, 1, 0]} : verticalAxis(box),
        (hit, more) => this.pick(hit, more), (hit, event) => this.hover(hit, event));
    } catch (error) {
      $('no-webgl').hidden = false;
      $('no-webgl').textContent = `The map needs WebGL 2, which this browser does not give (${error.message}). All else on the page works.`;
      $('canvas').hidden = true;
      return;
    }
    this.view.onLayout = (panes) => this.layout(panes);
    this.layout(this.view.panes());
    for (const [id, mode] of [['view-3d', '3d'], ['view-top', 'top']]) $(id).addEventListener('click', () => this.setMode(mode));
    this.setMode(flat ? 'top' : '3d');
    const actions = {left: () => this.view.turn(-0.3, 0), right: () => this.view.turn(0.3, 0), in: () => this.view.zoom(1.3), out: () => this.view.zoom(1 / 1.3), fit: () => this.view.fit()};
    for (const button of document.querySelectorAll('[data-camera]')) {
      button.append(icon(kIcons[button.dataset.camera]));
      button.addEventListener('click', actions[button.dataset.camera]);
    }
  }

  setMode(mode) {
    this.view.setMode(mode);
    const {north, axis} = this.view.vertical;
    const right = [0, 1, 2].find((k) => k !== axis && !north[k]);
    $('grid-note').textContent = `grid ${number(this.view.gridStep)} m${mode === 'top' ? ` · ${'xyz'[right]} →  ${'xyz'[north.indexOf(1)]} ↑` : ''}`;
    $('view-3d').setAttribute('aria-pressed', mode === '3d');
    $('view-top').setAttribute('aria-pressed', mode === 'top');
  }

  layout(panes) {
    $('labels').replaceChildren(...(this.several ? panes.map((pane, r) => element('div', {class: 'pane', style: `left:${pane.x}px;top:${pane.y}px;width:${pane.width}px;height:${pane.height}px`},
      element('span', {class: 'pane-name'}, element('i', {class: 'swatch swatch-dot', style: `--c:var(--run-${r % 4})`}), this.runs[r].name, ' ', element('span', {class: 'muted', 'data-pane': r})))) : []));
    this.paneCounts();
  }

  paneCounts() {
    for (const node of document.querySelectorAll('[data-pane]')) {
      const r = Number(node.dataset.pane), k = this.indexOf(r);
      node.textContent = `${plural(this.runs[r].keptBy[k] ?? 0, 'pose')}, ${plural(this.runs[r].linksBy[k] ?? 0, 'link')}`;
    }
  }

  has(name) {
    return this.runs.some((run) => ({
      kept: true, ...Object.fromEntries(['dropped', 'anchored', 'retired'].map((is) => [is, run.spells.some(({state}) => state === is)])), odometry: run.chain.from.length > 0, links: run.links.from.length > 0, truth: !!run.truth,
      candidates: run.decisions.candidates?.length > 0, ellipsoids: run.covariances.pose.length > 0,
    })[name]);
  }

  layerChips() {
    this.chipCounts = {};
    $('layers').append(...kLayers.filter((name) => !['anchored', 'retired'].includes(name) || this.has(name)).map((name) => {
      const [label, why] = kLayerWords[name], has = this.has(name);
      const box = element('input', {type: 'checkbox', checked: has, disabled: !has, 'data-layer': name, onchange: () => {
        for (const map of this.maps) map.setVisible(name, box.checked);
        this.view?.request();
      }});
      const count = this.chipCounts[name] = element('span', {class: 'chip-count'});
      return element('label', {class: `chip${has ? '' : ' off'}`, title: has ? why : kWithoutLayer[name] ?? why}, box,
        element('i', {class: `key key-${name}`}), label, count);
    }));
    if (!this.has('truth')) $('layers').append(element('span', {class: 'muted chip-note'}, kWithoutLayer.truth));
  }

  ellipsoidControls() {
    const node = $('ellipsoids');
    if (!this.has('ellipsoids')) {
      node.append(element('p', {class: 'empty'}, 'No covariances in this run, so there are no ellipsoids to draw.'));
      return;
    }
    const most = Math.max(...this.runs.map((run) => run.covariances.pose.length));
    this.every = element('input', {type: 'number', id: 'every', min: 0, max: most, value: Math.max(1, Math.ceil(most / 40)), oninput: () => this.showEllipsoids()});
    this.magnify = element('input', {type: 'range', id: 'magnify', min: 0, max: kMagnifications.length - 1, step: 1, value: this.firstMagnification(), oninput: () => this.showEllipsoids(), 'aria-label': 'Size of ellipsoids'});
    this.magnifyText = element('output', {for: 'magnify'});
    this.ids = element('input', {type: 'text', id: 'ids', inputmode: 'numeric', placeholder: 'click poses, or ids', onchange: () => this.readIds(), 'aria-label': 'Ids of poses chosen'});
    node.append(element('label', {}, 'of every ', this.every, ' th kept pose'), element('label', {}, 'drawn ', this.magnify, ' ', this.magnifyText), element('label', {}, 'and of poses ', this.ids));
    this.showEllipsoids();
  }

  magnification() { return kMagnifications[Number(this.magnify.value)]; }

  // True to scale, unless ellipsoids would then be too small to see or hide the map.
  firstMagnification() {
    const sizes = this.runs.flatMap((run) => run.covariances.position.map((c) => 2.8 * Math.sqrt(Math.max(c[0], c[3], c[5]))));
    sizes.sort((a, b) => a - b);
    const size = Math.max(sizes[Math.floor(0.8 * sizes.length)] ?? 1, 1e-12);
    const [least, most] = [0.008 * this.extent, 0.06 * this.extent];
    const wanted = size < least ? least / size : size > most ? most / size : 1;
    return kMagnifications.indexOf(kMagnifications.reduce((best, x) => (Math.abs(Math.log(x / wanted)) < Math.abs(Math.log(best / wanted)) ? x : best)));
  }

  readIds() {
    const ids = this.ids.value.split(/[^\d-]+/).filter(Boolean).map(Number);
    this.chosen = this.runs.map((run) => ids.map((id) => run.indexOfId.get(id)).filter((i) => i !== undefined));
    this.showEllipsoids();
    this.showPanels();
  }

  showEllipsoids() {
    if (!this.every) return;
    const every = Math.max(0, Math.floor(Number(this.every.value) || 0));
    this.magnifyText.textContent = this.magnification() === 1 ? 'true to scale' : `× ${number(this.magnification())}`;
    this.maps.forEach((map, r) => map.setEllipsoids(every, this.chosen[r], this.magnification()));
    this.view?.request();
  }

  pick(hit, more) {
    if (!hit) return;
    const id = this.runs[hit.run].id[hit.pose];
    const before = more && this.ids ? this.ids.value.split(/[^\d-]+/).filter(Boolean) : [];
    const next = before.includes(String(id)) ? before.filter((x) => x !== String(id)) : [...before, String(id)];
    if (this.ids) this.ids.value = next.join(', ');
    this.chosen = this.runs.map((run) => next.map((x) => run.indexOfId.get(Number(x))).filter((i) => i !== undefined));
    if (this.every) this.showEllipsoids();
    else this.maps.forEach((map, r) => map.setChosen(this.chosen[r]));
    this.view.request();
    this.showPanels();
  }

  hover(hit, event) {
    const tip = $('tip');
    tip.hidden = !hit;
    $('canvas').style.cursor = hit ? 'pointer' : '';
    if (!hit) return;
    const run = this.runs[hit.run], rect = $('stage').getBoundingClientRect();
    const covariance = run.covarianceOf.get(hit.pose);
    const several = run.ofSeveral.filter(({from, to}) => from === hit.pose || to === hit.pose);
    const most = several.length > 0 ? ` · ${several[0].kind} to ${run.id[several[0].from === hit.pose ? several[0].to : several[0].from]} ${madeOf(several[0])}${several.length > 1 ? `, and ${several.length - 1} more such` : ''}` : '';
    tip.textContent = `pose ${run.id[hit.pose]} · ${fate(run, hit.pose)}${most}${covariance ? ` · ±${number(Math.hypot(...halfAxes(covariance, run.dimension)[0]), 2)} m` : ''}`;
    const x = Math.min(event.clientX - rect.left + 14, rect.width - tip.offsetWidth - 6);
    tip.style.transform = `translate(${x}px, ${Math.max(event.clientY - rect.top - 34, 4)}px)`;
  }

  indexOf(r) { return this.alignment.indices[r][this.timeline?.position ?? 0] ?? 0; }

  showStep() {
    this.maps.forEach((map, r) => map.setStep(this.indexOf(r)));
    this.view?.request();
    this.plots.setPosition(this.timeline.position);
    this.showPanelsSoon();
    this.paneCounts();
    const sum = (of) => this.runs.map((run, r) => of(run, this.indexOf(r), r)).map(integer).join(' | ');
    this.chipCounts.kept.textContent = sum((run, k) => run.keptBy[k] ?? 0);
    this.chipCounts.dropped.textContent = sum((run, k) => run.droppedBy[k] ?? 0);
    if (this.chipCounts.anchored) this.chipCounts.anchored.textContent = sum((run, k) => run.anchoredBy[k] ?? 0);
    if (this.chipCounts.retired) this.chipCounts.retired.textContent = sum((run, k) => run.retiredBy[k] ?? 0);
    this.chipCounts.links.textContent = sum((run, k) => run.linksBy[k] ?? 0);
  }

  // While the slider plays the text changes ten times a second, which is more than can be read.
  showPanelsSoon() {
    const wait = this.timeline.playing ? this.panelsAt + 100 - performance.now() : 0;
    if (!(wait > 0)) {
      this.showPanels();
    } else if (!this.panelsTimer) {
      this.panelsTimer = setTimeout(() => {
        this.panelsTimer = null;
        this.showPanels();
      }, wait);
    }
  }

  showPanels() {
    this.panelsAt = performance.now();
    this.runs.forEach((run, r) => showDecision(this.panels[r], run, this.indexOf(r), {
      named: this.several, chosen: this.chosen[r][this.chosen[r].length - 1] ?? null,
      onStep: (k) => this.timeline.jump(this.alignment.indices[r].findIndex((i) => i >= k)),
    }));
  }

  setTheme(name) {
    this.view?.setTheme(name);
    this.showRamp(name);
    if (this.plots.plots.length) this.plots.build(this.alignment);
  }

  showRamp(name) {
    const node = $('ramp');
    node.hidden = !this.has('links');
    if (node.hidden) return;
    const colours = ramp(name).map(cssColour);
    document.documentElement.style.setProperty('--ramp', `linear-gradient(90deg, ${colours.join(', ')})`);
    const unknown = this.runs.some((run) => run.links.gain.some((gain) => !isNumber(gain)));
    const {scale} = this;
    const tick = (t) => element('span', {}, number(scale.inverse(t), 2));
    node.replaceChildren(...[
      scale && element('div', {class: 'ramp-title'}, `gain of links, nats${scale.logarithmic ? ' (log)' : ''}`),
      scale && element('div', {class: 'ramp-bar'}),
      scale && element('div', {class: 'ramp-ticks'}, scale.low < scale.high ? [tick(0), tick(0.5), tick(1)] : [element('span', {}), tick(0.5), element('span', {})]),
      unknown && element('div', {class: 'ramp-none'}, element('i', {class: 'swatch swatch-line', style: '--c:var(--no-gain)'}), scale ? 'gain not measured' : 'gain of links not measured'),
    ].filter(Boolean));
  }

  keys() {
    $('theme').append(icon(kIcons.theme));
    $('theme').title = 'Light or dark';
    $('theme').addEventListener('click', () => this.theme.toggle());
    document.addEventListener('keydown', (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest?.('select, input[type=text], input[type=number]')) return;
      if (event.key.toLowerCase() === 'v' && this.view) this.setMode(this.view.mode === '3d' ? 'top' : '3d');
      if (event.key.toLowerCase() === 'd') this.theme.toggle();
    });
    $('keys').append(element('dl', {class: 'key-list'}, kKeys.map(([key, what]) => element('div', {}, element('dt', {}, key), element('dd', {}, what)))));
  }
}

function fail(message) {
  $('main').replaceChildren(element('p', {class: 'card empty', role: 'alert'}, message));
  $('player').hidden = true;
}

const report = readReport($('terse-data').textContent);
if (report.error) fail(report.error);
else window.terseReport = new Page(report);  // for a look from the console
