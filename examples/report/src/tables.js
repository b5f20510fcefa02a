// Thresholds and summary, each number with its key and its full value beside the one for people.

import {isNumber} from './data.js';
import {madeOf, nats} from './explain.js';
import {element, integer, number, plural, seconds} from './format.js';

const kLabels = {
  poses: 'poses of the input', edges: 'edges of the input', loop_edges: 'loop edges of the input', poses_kept: 'poses kept', links_kept: 'links kept',
  links_offered: 'links offered', links_refused: 'links refused by the innovation test', registrations_tried: 'registrations tried',
  poses_anchored: 'poses found again at kept ones', edges_composed: 'edges that hold composed measurements', measurements_composed: 'measurements composed of links', edges_fused: 'edges fused of several measurements',
  poses_retired: 'poses retired from the map', retired_loss_nats: 'information lost with retired poses, nats',
  chi2: 'χ² of the map', normalized_chi2: 'χ² per measured scalar', log_determinant: 'ln det H', peak_rss_mb: 'peak memory, MB',
  'step_seconds.median': 'median', 'step_seconds.p95': '95th percentile', 'step_seconds.p99': '99th percentile', 'step_seconds.max': 'greatest',
  'sample.poses': 'poses', 'sample.loop_gain_90': '90th percentile of loop gains, nats', 'sample.pose_gain_90': '90th percentile of pose gains, nats',
  fps: 'frames per second', keyframes_stored: 'key frames stored', feature_bytes: 'bytes of features', refused_by_innovation: 'refused by the innovation test',
};
const kGroups = {seconds: 'Time', step_seconds: 'Time of a step', sample: 'Sample that thresholds were chosen from', errors: 'Errors', odometry_errors: 'Errors of the odometry alone',
  milliseconds_per_frame: 'Milliseconds per frame', robust: 'Robust cost'};
const kOrder = ['strategy', 'poses', 'poses_kept', 'loop_edges', 'edges', 'links_offered', 'links_kept', 'poses_anchored', 'edges_composed', 'measurements_composed', 'edges_fused', 'poses_retired', 'retired_loss_nats', 'registrations_tried', 'links_refused', 'chi2',
  'normalized_chi2', 'converged', 'termination', 'iterations'];
const kThresholds = {
  range: ['Sensor range', 'displacements within it can be registered'], probability: ['Least probability', 'of being in range, per dimension'],
  min_loop_gain: ['Least gain of a link', 'nats; a link below it is not taken'], min_pose_gain: ['Least gain of a pose', 'nats; a pose below it is dropped unless a loop closes there'],
  dimension: ['Dimension', ''],
};

// [key, value] of all leaves; lists are leaves.
function leaves(object, prefix = '') {
  return Object.entries(object ?? {}).flatMap(([name, value]) =>
    (value !== null && typeof value === 'object' && !Array.isArray(value) ? leaves(value, `${prefix}${name}.`) : [[prefix + name, value]]));
}

function show(key, value) {
  if (value === undefined) return 'not recorded';
  if (value === null) return 'none';
  if (typeof value === 'boolean') return value ? 'yes' : 'no';
  if (Array.isArray(value)) {
    if (value.length === 0) return 'none';
    return value.every(isNumber) && value.length <= 6 ? value.map((x) => number(x, 3)).join('  ') : plural(value.length, 'entry', 'entries');
  }
  if (!isNumber(value)) return String(value);
  if (/(^|\.)seconds(\.|$)|step_seconds|_seconds$/.test(key)) return seconds(value);
  return number(value, 5);
}

function showRange(value, dimension) {
  if (!Array.isArray(value)) return show('range', value);
  const lengths = value.slice(0, dimension).map((x) => number(x, 3)).join(' × ');
  return `${lengths} m, ${number(value[dimension], 3)} rad`;
}

const cell = (key, value, text) => element('td', {'data-key': key, 'data-value': value === undefined ? null : JSON.stringify(value)}, text);

function ratio(values) {
  const [a, b] = values;
  return isNumber(a) && isNumber(b) && a !== 0 ? `×\u00a0${number(b / a, 3)}` : '';
}

// rows: [key, label, note, [value of each run], formatter]
function table(runs, caption, rows) {
  const several = runs.length > 1;
  const head = several && element('thead', {}, element('tr', {}, element('th', {scope: 'col', class: 'caption'}, caption || element('span', {class: 'sr-only'}, 'quantity')),
    runs.map((run, r) => element('th', {scope: 'col'}, element('i', {class: 'swatch swatch-dot', style: `--c:var(--run-${r % 4})`}), run.name)),
    runs.length === 2 && element('th', {scope: 'col', title: `${runs[1].name} over ${runs[0].name}`}, 'ratio')));
  return element('table', {class: 'numbers'}, !several && caption && element('caption', {}, caption), head,
    element('tbody', {}, rows.map(([key, label, note, values, text]) => element('tr', {},
      element('th', {scope: 'row'}, label, note ? element('span', {class: 'note'}, note) : ''),
      values.map((value, r) => cell(key, value, text(value, r))),
      runs.length === 2 && element('td', {class: 'ratio'}, ratio(values))))));
}

function unionOfKeys(lists) {
  const keys = [];
  for (const list of lists) for (const [key] of list) if (!keys.includes(key)) keys.push(key);
  return keys;
}

function thresholdsCard(runs) {
  const lists = runs.map((run) => leaves(run.thresholds));
  const keys = unionOfKeys(lists);
  const order = Object.keys(kThresholds);
  keys.sort((a, b) => (order.indexOf(a) + 1 || 99) - (order.indexOf(b) + 1 || 99));
  const rows = keys.map((key) => [`thresholds.${key}`, ...(kThresholds[key] ?? [key, '']), runs.map((_, r) => lists[r].find(([k]) => k === key)?.[1]),
    (value, r) => (key === 'range' ? showRange(value, runs[r].dimension) : show(key, value))]);
  return element('section', {class: 'card', id: 'thresholds', 'aria-labelledby': 'thresholds-title'},
    element('div', {class: 'card-head'}, element('h2', {id: 'thresholds-title'}, 'Thresholds')),
    rows.length ? element('div', {class: 'scroll'}, table(runs, null, rows)) : element('p', {class: 'empty'}, 'The run has no thresholds: all poses and links are kept.'));
}

function summaryCard(runs) {
  const lists = runs.map((run) => leaves({...run.stats, thresholds: undefined}));
  const maps = lists.map((list) => new Map(list));
  const place = (key) => kOrder.indexOf(key) + 1 || 99;
  const keys = unionOfKeys(lists).filter((key) => key !== 'thresholds').map((key, i) => [key, i])
    .sort(([a, i], [b, j]) => place(a) - place(b) || i - j).map(([key]) => key);
  const groups = new Map([['', []]]);
  for (const key of keys) {
    const name = key.includes('.') ? key.split('.')[0] : '';
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push([key, kLabels[key] ?? key.slice(name ? name.length + 1 : 0).replace(/[_.]/g, ' '), '', maps.map((map) => map.get(key)), (value) => show(key, value)]);
  }
  const tables = [...groups].filter(([, rows]) => rows.length).map(([name, rows]) => table(runs, name ? kGroups[name] ?? name.replace(/_/g, ' ') : 'Map', rows));
  return element('section', {class: 'card', id: 'summary', 'aria-labelledby': 'summary-title'},
    element('div', {class: 'card-head'}, element('h2', {id: 'summary-title'}, 'Summary'), element('p', {class: 'muted'}, 'The numbers of stats.json; hover for all digits.')),
    tables.length ? element('div', {class: 'scroll summary-groups'}, tables) : element('p', {class: 'empty'}, 'The run has no stats.json.'));
}

const kMostEdges = 200;

// Which edges of the map are not one measurement. Nothing for runs without such.
function edgesCard(runs) {
  if (runs.every((run) => run.ofSeveral.length === 0)) return null;
  const head = ['edge', 'kind', 'measurements', 'gain'].map((name) => element('th', {scope: 'col'}, name));
  const tables = runs.map((run, r) => [
    runs.length > 1 && element('h3', {}, element('i', {class: 'swatch swatch-dot', style: `--c:var(--run-${r % 4})`}), run.name),
    element('p', {class: 'muted'}, `${plural(run.ofSeveral.length, 'edge')} between kept poses ${run.ofSeveral.length === 1 ? 'is' : 'are'} composed of links or fused of several measurements.`),
    run.ofSeveral.length > 0 && element('table', {class: 'numbers edges-of-several'}, element('thead', {}, element('tr', {}, head)),
      element('tbody', {}, run.ofSeveral.slice(0, kMostEdges).map((edge) => element('tr', {},
        element('th', {scope: 'row'}, `${run.id[edge.from]} – ${run.id[edge.to]}`), element('td', {}, edge.kind),
        element('td', {title: madeOf(edge)}, madeOf(edge)), element('td', {}, isNumber(edge.gain) ? nats(edge.gain) : 'none'))))),
    run.ofSeveral.length > kMostEdges && element('p', {class: 'muted'}, `and ${integer(run.ofSeveral.length - kMostEdges)} more`)]);
  return element('section', {class: 'card', id: 'edges', 'aria-labelledby': 'edges-title'},
    element('div', {class: 'card-head'}, element('h2', {id: 'edges-title'}, 'Composed and fused edges')),
    element('div', {class: 'scroll edges-list', tabindex: '0', role: 'region', 'aria-label': 'Composed and fused edges'}, tables.flat().filter(Boolean)));
}

export function showTables(node, runs) {
  node.classList.toggle('compare', runs.length > 1);
  node.replaceChildren(...[thresholdsCard(runs), summaryCard(runs), edgesCard(runs)].filter(Boolean));
  for (const td of node.querySelectorAll('td[data-value]')) td.title = td.dataset.value;
}


function median(list) {
  const sorted = (list ?? []).filter(isNumber).sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)];
}

// The few numbers at the top.
export function showFigures(node, runs) {
  const figures = [
    ['Poses kept', (run) => [integer(run.keptBy[run.n - 1] ?? 0), `of ${integer(run.n)}`]],
    ['Links kept', (run) => [integer(run.linksBy[run.n - 1] ?? 0), isNumber(run.stats.links_offered) ? `of ${integer(run.stats.links_offered)}` : 'beside the odometry']],
    ...(runs.some((run) => isNumber(run.stats.poses_anchored)) ? [['Found again', (run) => [integer(run.anchoredBy[run.n - 1] ?? 0), 'poses, at kept ones']]] : []),
    ...(runs.some((run) => run.stats.poses_retired > 0) ? [['Retired', (run) => [isNumber(run.stats.poses_retired) ? integer(run.stats.poses_retired) : '0',
      isNumber(run.stats.retired_loss_nats) ? `poses, ${number(run.stats.retired_loss_nats, 2)} nats lost` : 'poses']]] : []),
    ['Registrations', (run) => [isNumber(run.stats.registrations_tried) ? integer(run.stats.registrations_tried) : isNumber(run.stats.compared) ? integer(run.stats.compared) : 'not recorded', 'tried']],
    ['Error (ATE)', (run) => {
      const ate = run.stats.errors?.ate_m;
      return isNumber(ate) ? [`${number(ate, 3)} m`, 'RMS'] : (run.truth ? ['not recorded', ''] : ['unknown', 'no ground truth']);
    }],
    ['χ² per scalar', (run) => [isNumber(run.stats.normalized_chi2) ? number(run.stats.normalized_chi2, 3) : 'not recorded', run.stats.converged === false ? 'not converged' : run.stats.converged ? 'converged' : '']],
    ['Median step', (run) => {
      const total = isNumber(run.stats.seconds) ? run.stats.seconds : run.stats.seconds?.total;
      const note = isNumber(run.stats.fps) ? `${number(run.stats.fps, 3)} frames/s` : isNumber(total) ? `${seconds(total)} in all` : '';
      const step = run.stats.step_seconds?.median ?? median(run.steps.seconds);
      return [isNumber(step) ? seconds(step) : 'not recorded', note];
    }],
  ];
  node.replaceChildren(...figures.map(([name, of]) => element('div', {class: 'figure'}, element('div', {class: 'figure-name'}, name),
    runs.map((run, r) => {
      const [value, note] = of(run);
      return element('div', {class: 'figure-row'}, runs.length > 1 && element('i', {class: 'swatch swatch-dot', style: `--c:var(--run-${r % 4})`, title: run.name}),
        element('span', {class: 'figure-value'}, value), element('span', {class: 'figure-note'}, note));
    }))));
}
