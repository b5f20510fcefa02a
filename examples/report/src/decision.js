// The panel that explains one step of one run, and the pose that was clicked.

import {isNumber} from './data.js';
import {composedAt, explain, fate, madeOf, othersAt, outcome, verdictInShort} from './explain.js';
import {element, integer, number, percent} from './format.js';
import {halfAxes} from './scene3d.js';

const kMostRows = 40;

const probability = (x) => (!isNumber(x) ? 'unknown' : x > 0.9995 && x < 1 ? '> 0.999' : x >= 1 ? '1' : number(x, 3));

function gauge(gain, threshold) {
  if (!isNumber(gain) || !isNumber(threshold)) return null;
  const full = Math.max(gain, threshold, 1e-9) * 1.15;
  const width = (x) => `${(100 * Math.min(Math.max(x / full, 0), 1)).toFixed(2)}%`;
  return element('div', {class: 'gauge', role: 'img', 'aria-label': `pose gain ${number(gain, 3)} nats, threshold ${number(threshold, 3)} nats`},
    element('div', {class: 'gauge-row'}, element('span', {}, 'pose gain'), element('strong', {}, `${number(gain, 3)} nats`),
      element('span', {class: 'muted'}, `threshold ${number(threshold, 3)}`)),
    element('div', {class: 'gauge-bar'},
      element('div', {class: 'gauge-fill', style: `width:${width(gain)}`}),
      element('div', {class: 'gauge-mark', style: `left:${width(threshold)}`})));
}

const valueOr = (x, words) => (isNumber(x) ? number(x, 3) : element('span', {class: 'muted'}, words));

function candidateTable(run, list) {
  const evaluated = list.some((c) => c[1] > 0 || c[2] > 0);
  const order = list.map((c, i) => [c, i]).sort(([a, i], [b, j]) => b[4] - a[4] || (b[3] ?? b[2] ?? 0) - (a[3] ?? a[2] ?? 0) || i - j);
  const rows = order.slice(0, kMostRows).map(([c]) => {
    const {word, why} = outcome(run, c);
    return element('tr', {class: c[4] ? 'accepted' : c[8] ? 'served' : ''},
      element('th', {scope: 'row'}, String(run.id[c[0]] ?? 'unknown')),
      evaluated && element('td', {}, probability(c[1])), evaluated && element('td', {}, number(c[2], 3)),
      element('td', {}, valueOr(c[3], 'none')), element('td', {}, valueOr(c[5], 'untested')),
      element('td', {class: 'word', title: why}, c[4] ? '✓ ' : '', word));
  });
  const head = [['pose', 'kept pose that a link was considered to'],
    ...(evaluated ? [['prob.', 'least probability, over the dimensions, of being in range'], ['gain', 'expected, nats']] : []), ['measured', 'gain of the registered link, nats'], ['innov.', 'squared Mahalanobis distance of the registered link from what was known'],
    ['outcome', '']];
  return element('div', {class: 'scroll candidates', tabindex: '0', role: 'region', 'aria-label': 'Candidates'},
    element('table', {},
      element('thead', {}, element('tr', {}, head.map(([name, why]) => element('th', {scope: 'col', title: why}, name)))),
      element('tbody', {}, rows)),
    list.length > kMostRows && element('p', {class: 'muted'}, `and ${integer(list.length - kMostRows)} more`));
}

// Edges between kept poses that the links of this step made.
function composedList(run, k) {
  const made = composedAt(run, k);
  if (made.length === 0) return null;
  return element('div', {class: 'composed'}, element('strong', {}, 'Between kept poses'),
    element('ul', {}, made.map(({edge, words}) => element('li', {}, element('strong', {}, edge), ` ${words}`))));
}

// The edges at a kept pose that are not one measurement.
function edgesAt(run, k) {
  const list = run.ofSeveral.filter(({from, to}) => from === k || to === k);
  if (list.length === 0) return null;
  return element('ul', {}, list.slice(0, kMostRows).map((edge) => element('li', {}, `${edge.kind} to pose ${run.id[edge.from === k ? edge.to : edge.from]}: ${madeOf(edge)}`)));
}

function chosenPose(run, k, onStep) {
  const p = ['x', 'y', 'z'].slice(0, run.dimension).map((axis) => number(run.position[axis][k], 4));
  const covariance = run.covarianceOf.get(k);
  const sizes = covariance && halfAxes(covariance, run.dimension).slice(0, run.dimension).map((axis) => number(Math.hypot(...axis), 3));
  return element('div', {class: 'chosen'},
    element('strong', {}, `Pose ${run.id[k]}`), ` · ${fate(run, k)} · at (${p.join(', ')}) m · `,
    sizes ? `95 % half axes ${sizes.join(', ')} m` : run.kept[k] ? 'no covariance given' : `a ${run.retiredAt[k] === null ? 'dropped' : 'retired'} pose has no ellipsoid here`, ' ',
    element('button', {type: 'button', class: 'link-button', onclick: () => onStep(k)}, 'go to its step'), edgesAt(run, k));
}

// `node` is filled anew. `chosen`: index of the pose clicked last in this run, or null.
export function showDecision(node, run, k, {named, chosen, onStep}) {
  if (run.n === 0) {
    node.replaceChildren(element('p', {class: 'empty'}, 'This run has no poses.'));
    return;
  }
  const list = run.decisions.candidates?.[k] ?? [];
  const {decisions} = run;
  const known = decisions.registrations?.length > 0;
  const count = (name) => integer(decisions[name]?.[k] ?? NaN);
  const keptSoFar = run.keptBy[k];
  const parts = [
    element('div', {class: 'card-head'},
      element('h2', {}, named ? `${run.name}: ` : '', `pose ${run.id[k]}`),
      element('span', {class: `badge ${run.everKept[k] ? 'badge-kept' : run.anchored[k] ? 'badge-anchored' : 'badge-dropped'}`},
        run.everKept[k] ? 'kept' : run.anchored[k] ? 'not kept' : 'dropped', verdictInShort(run, k) && element('span', {class: 'badge-why'}, verdictInShort(run, k)))),
    element('p', {class: 'explanation'}, explain(run, k)),
    ...othersAt(run, k).map((sentence) => element('p', {class: 'others'}, sentence)),
    gauge(decisions.pose_gain?.[k], run.thresholds.min_pose_gain),
    element('dl', {class: 'counts'},
      [['tried', known ? count('registrations') : 'not recorded', 'registrations at this step'], ['accepted', known ? count('accepted') : 'not recorded', 'links of this step'],
        ['refused', known ? count('refused') : 'not recorded', 'by the innovation test'], ['poses', `${integer(keptSoFar)} (${percent(keptSoFar, k + 1)})`, 'in the map then'],
        ['links', integer(run.linksBy[k]), 'kept so far']]
        .map(([name, value, why]) => element('div', {title: why}, element('dt', {}, name), element('dd', {}, value)))),
    composedList(run, k),
    list.length > 0 ? candidateTable(run, list)
      : element('p', {class: 'empty'}, !decisions.candidates?.length ? 'The candidates of the steps are not known: the run wrote no decisions.'
        : 'No kept pose was considered for a link at this step.'),
    chosen != null && chosenPose(run, chosen, onStep),
  ];
  node.replaceChildren(...parts.filter(Boolean));
}
