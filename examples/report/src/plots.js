// Plots over the steps: a line across all of them stands at the slider's step, dragging in one moves the slider.

import uPlot from 'uplot';

import {cssVariable} from './colour.js';
import {isNumber} from './data.js';
import {element, number, seconds} from './format.js';

const kHeight = 168;
const kMissing = 'Not recorded in this run.';

const squareMetres = (x) => `${number(x, 4)} m²`;
const positive = (list) => list?.map((x) => (isNumber(x) && x > 0 ? x : null));
const some = (list) => Array.isArray(list) && list.some(isNumber);
const words = (name) => String(name ?? 'gate').replace(/_/g, ' ');

function runningSum(list) {
  let sum = 0;
  return list?.map((x) => (sum += x ?? 0));
}

// Counts after each step; after the last one those of the map, from which poses may have retired at the end of the run.
function untilTheEnd(steps, counts) {
  return steps && counts.length > 0 ? [...steps.slice(0, counts.length - 1), counts[counts.length - 1]] : Array.from(counts);
}

// What to plot of one run. A series: label, values by step; `dots` without a line. `dash` tells the second series where
// colours tell the runs.
function chartsOf(run) {
  const {steps, decisions, thresholds} = run;
  const gate = (open) => positive(steps.gate_value)?.map((x, i) => (steps.gate_open?.[i] === open ? x : null));
  const poses = untilTheEnd(steps.poses, run.keptBy), links = untilTheEnd(steps.links, run.linksBy);
  return [
    {key: 'counts', title: 'Poses and links kept', series: [{label: 'poses', values: poses},
      {label: 'links', values: links, dash: true}]},
    {key: 'area', title: 'Kept poses and explored area', unit: run.area ? `in cells of ${number(run.area.cell, 3)} m, the range` : '',
      series: [{label: 'poses', values: run.area && poses},
        {label: 'area', values: run.area?.explored, dash: true, right: true, format: squareMetres}],
      empty: 'The range of the sensor is not known, so there are no cells to count.'},
    {key: 'gain', title: 'Greatest gain of the links of a step', unit: 'nats', threshold: thresholds.min_loop_gain,
      series: [{label: 'gain', values: steps.gain, dots: true}],
      empty: 'No accepted link has a measured gain. (Strategies that keep every link measure none.)'},
    {key: 'pose_gain', title: 'Least gain that a link to the pose would have', unit: 'nats', threshold: thresholds.min_pose_gain,
      series: [{label: 'gain', values: decisions.pose_gain, dots: run.n > 400}],
      empty: 'No pose was judged by its gain: that is for strategies that drop poses.'},
    {key: 'gate', title: `Gate of the map's updates: ${words(run.gate)}`, unit: run.gateUnit, log: true,
      series: [{label: 'opened', values: gate(1), dots: true}, {label: 'stayed closed', values: gate(0), dots: true, hollow: true}]},
    {key: 'seconds', title: 'Time of a step', format: seconds, log: true, series: [{label: 'time', values: positive(steps.seconds), dots: run.n > 400}]},
    {key: 'nonzeros', title: 'Nonzeros of H and of its factor', series: [{label: 'H', values: steps.hessian_nonzeros},
      {label: 'factor', values: steps.factor_nonzeros, dash: true}]},
    {key: 'ate', title: 'Absolute trajectory error so far', unit: 'm', series: [{label: 'ATE', values: steps.ate_m}],
      empty: run.truth ? kMissing : 'No ground truth given: pass --ground-truth.'},
    {key: 'registrations', title: 'Registrations tried so far', series: [{label: 'registrations', values: runningSum(decisions.registrations)}]},
  ];
}

// Index of the last value at or before each position, -1 if there is none.
function lastKnown(values) {
  let last = -1;
  return Int32Array.from(values, (x, i) => (x == null ? last : (last = i)));
}

// Not more than five of them.
function powersOfTen(u, axis, low, high) {
  const from = Math.ceil(Math.log10(low) - 1e-9), to = Math.floor(Math.log10(high) + 1e-9);
  const stride = Math.ceil((to - from + 1) / 5);
  return Array.from({length: Math.floor((to - from) / stride) + 1}, (_, i) => 10 ** (from + i * stride));
}

// Squares for many dots, one where several would cover each other.
const squares = (size) => (u, k, from, to) => {
  const path = new Path2D(), taken = new Set(), side = size * devicePixelRatio;
  for (let i = from; i <= to; i++) {
    if (u.data[k][i] == null) continue;
    const x = Math.round(u.valToPos(i, 'x', true) / side), y = Math.round(u.valToPos(u.data[k][i], 'y', true) / side);
    if (taken.has(x * 65536 + y)) continue;
    taken.add(x * 65536 + y);
    path.rect((x - 0.5) * side, (y - 0.5) * side, side, side);
  }
  return {fill: path, stroke: null, clip: null, flags: 3};
};

function dotsOf(one, few) {
  if (!few) return {show: true, size: 3, width: 0, stroke: one.colour, fill: one.hollow ? `${one.colour}60` : one.colour, paths: squares(2)};
  return {show: true, size: 5, width: 1, stroke: one.colour, fill: one.hollow ? 'transparent' : one.colour};
}

export class Plots {
  constructor(node, runs, onStep) {
    Object.assign(this, {node, runs, onStep, plots: [], position: 0});
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(node);
  }

  // Draws all anew: at first, when the theme or the alignment of the runs changed.
  build(alignment) {
    this.alignment = alignment;
    for (const {plot} of this.plots) plot?.destroy();
    const charts = this.runs.map(chartsOf);
    this.plots = charts[0].map((chart, i) => this.makePlot(chart, charts.map((list) => list[i])));
    this.node.replaceChildren(...this.plots.map(({box}) => box));
    for (const entry of this.plots) if (entry.options) this.start(entry);
    this.setPosition(this.position);
  }

  makePlot(chart, versions) {
    const several = this.runs.length > 1;
    const series = versions.flatMap((version, r) => version.series.filter(({values}) => some(values)).map((one, s) => ({
      ...one, run: r, colour: cssVariable(several ? `--run-${r % 4}` : `--plot-${s}`), dash: several && one.dash,
      label: several ? `${this.runs[r].name} ${version.series.length > 1 ? one.label : ''}`.trim() : one.label,
      values: Array.from(this.alignment.indices[r], (k) => (isNumber(one.values[k]) ? one.values[k] : null)),
    })));
    const readout = element('div', {class: 'plot-readout'});
    const area = element('div', {class: 'plot-area'});
    const title = element('h3', {}, chart.title, chart.unit ? element('span', {class: 'muted'}, ` ${chart.unit}`) : '');
    const box = element('figure', {class: 'plot', 'data-plot': chart.key, 'aria-label': chart.title}, title, readout, area);
    if (series.length === 0) {
      area.append(element('p', {class: 'empty'}, chart.empty ?? kMissing));
      return {box};
    }
    const format = chart.format ?? ((x) => number(x, 4));
    const values = series.map((one) => {
      const value = element('span', {class: 'plot-value'});
      readout.append(element('span', {class: 'plot-key'}, element('i', {class: `swatch ${one.dots ? (one.hollow ? 'swatch-ring' : 'swatch-dot') : 'swatch-line'}${one.dash ? ' dashed' : ''}`,
        style: `--c:${one.colour}`}), one.label, ' ', value));
      return {node: value, last: lastKnown(one.values), one};
    });
    // Of runs that have something to hold against them; once where they are the same.
    const thresholds = versions.map(({threshold}, r) => ({value: threshold, colour: cssVariable(several ? `--run-${r % 4}` : '--threshold'), run: r}))
      .filter(({value, run}) => isNumber(value) && value > 0 && series.some((one) => one.run === run))
      .filter((t, i, all) => all.findIndex((other) => other.value === t.value) === i);
    return {box, area, values, format, options: this.optionsFor(chart, series, thresholds), data: [Array.from({length: this.alignment.count}, (_, k) => k), ...series.map(({values: v}) => v)]};
  }

  optionsFor(chart, series, thresholds) {
    const text = cssVariable('--muted'), grid = cssVariable('--plot-grid');
    const axis = {stroke: text, font: '11px system-ui, sans-serif', grid: {stroke: grid, width: 1}, ticks: {show: false}, gap: 6};
    const format = chart.format ?? ((x) => number(x, 3));
    const few = series[0].values.length <= 400;
    const right = series.find((one) => one.right);  // has a scale of its own
    const fromZero = (u, low, high) => (high == null ? [0, 1] : uPlot.rangeNum(0, high, 0.08, true));
    const drawThresholds = (u) => {
      for (const {value, colour} of thresholds) {
        const y = u.valToPos(value, 'y', true);
        const {ctx, bbox} = u;
        if (y < bbox.top || y > bbox.top + bbox.height) continue;
        ctx.save();
        ctx.strokeStyle = colour;
        ctx.setLineDash([6 * devicePixelRatio, 4 * devicePixelRatio]);
        ctx.lineWidth = 1.4 * devicePixelRatio;
        ctx.beginPath();
        ctx.moveTo(bbox.left, y);
        ctx.lineTo(bbox.left + bbox.width, y);
        ctx.stroke();
        ctx.fillStyle = cssVariable('--text');
        ctx.font = `${11 * devicePixelRatio}px system-ui, sans-serif`;
        ctx.textAlign = 'right';
        const below = y - bbox.top < 16 * devicePixelRatio;
        ctx.textBaseline = below ? 'top' : 'bottom';
        const label = [`threshold ${number(value, 3)}`, bbox.left + bbox.width - 4, y + (below ? 4 : -4)];
        ctx.setLineDash([]);
        ctx.lineJoin = 'round';
        ctx.lineWidth = 4 * devicePixelRatio;
        ctx.strokeStyle = cssVariable('--surface');
        ctx.strokeText(...label);  // readable on dots, too
        ctx.fillText(...label);
        ctx.restore();
      }
    };
    const reach = Math.max(...thresholds.map(({value}) => value), 0) * 1.1;
    const range = (u, low, high) => (low == null ? [0, Math.max(reach, 1)] : uPlot.rangeNum(Math.min(low, 0), Math.max(high, reach), 0.08, true));
    return {
      width: 300, height: kHeight, legend: {show: false}, padding: [8, 8, 0, 0],
      cursor: {y: false, drag: {x: false, y: false, setScale: false}, points: {size: 6}},
      scales: {x: {time: false, range: [0, Math.max(this.alignment.count - 1, 1)]}, y: chart.log ? {distr: 3} : {range}, ...(right ? {right: {range: fromZero}} : {})},
      axes: [{...axis, size: 26, space: 60, values: (u, list) => list.map((x) => (Number.isInteger(x) ? number(x) : ''))},
        {...axis, size: 56, space: 28, ...(chart.log ? {splits: powersOfTen, filter: (u, list) => list} : {}), values: (u, list) => list.map((x) => (x == null ? '' : format(x)))},
        ...(right ? [{...axis, scale: 'right', side: 1, size: 62, space: 28, grid: {show: false}, values: (u, list) => list.map(right.format)}] : [])],
      series: [{}, ...series.map((one) => ({
        label: one.label, scale: one.right ? 'right' : 'y', stroke: one.colour, width: 1.5, dash: one.dash ? [5, 4] : undefined, spanGaps: true,
        ...(one.dots ? {paths: () => null, points: dotsOf(one, few)}
          : {points: {show: false}}),
      }))],
      hooks: {draw: [drawThresholds]},
    };
  }

  start(entry) {
    entry.options.width = Math.max(entry.area.clientWidth, 120);
    entry.plot = new uPlot(entry.options, entry.data, entry.area);
    entry.line = element('div', {class: 'plot-step'});
    const {over} = entry.plot;
    over.append(entry.line);
    const move = (event) => {
      const x = event.clientX - over.getBoundingClientRect().left;
      this.onStep(entry.plot.posToVal(x, 'x'));
    };
    over.addEventListener('pointerdown', (event) => {
      if (event.button !== 0) return;
      over.setPointerCapture(event.pointerId);
      move(event);
    });
    over.addEventListener('pointermove', (event) => {
      if (over.hasPointerCapture(event.pointerId)) move(event);
    });
  }

  resize() {
    for (const {plot, area} of this.plots) {
      if (plot && area.clientWidth > 0 && area.clientWidth !== plot.width) plot.setSize({width: area.clientWidth, height: kHeight});
    }
    this.setPosition(this.position);
  }

  setPosition(position) {
    this.position = position;
    for (const {plot, line, values, format} of this.plots) {
      if (!plot) continue;
      line.style.transform = `translateX(${plot.valToPos(position, 'x').toFixed(1)}px)`;
      for (const {node, last, one} of values) {
        // Of dots only what belongs to this very step; lines hold until their next value.
        const at = last[position];
        node.textContent = at < 0 || (one.dots && at !== position) ? 'none' : (one.format ?? format)(one.values[at]);
      }
    }
  }
}
