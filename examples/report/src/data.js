// The data of the report: checked, with counts by step and the alignment of several runs.

export const kChi2 = {2: 5.991465, 3: 7.814728};  // 95 % of a chi-square variable

const finite = (x) => typeof x === 'number' && Number.isFinite(x);
export const isNumber = finite;

// `text` is what stands in the page's data element. Returns {version, runs}, or {error}.
export function readReport(text) {
  let data;
  try {
    data = JSON.parse(text);
  } catch (error) {
    return {error: `The data in this page cannot be read: ${error.message}`};
  }
  if (typeof data === 'string') {
    return {error: 'This page holds no data yet. "terse report DIR" writes a copy of it that does.'};
  }
  if (data?.format !== 'terse-report-1' || !Array.isArray(data.runs) || data.runs.length === 0) {
    return {error: `The data in this page is of format ${JSON.stringify(data?.format)}; this page reads terse-report-1.`};
  }
  return {version: data.version, runs: data.runs.map(readRun)};
}

const orNaN = (list, n) => Float64Array.from({length: n}, (_, i) => (finite(list?.[i]) ? list[i] : NaN));

// counts[k]: how many of the ascending `steps` are <= k.
function countsByStep(steps, n) {
  const counts = new Int32Array(n);
  for (const step of steps) if (step >= 0 && step < n) counts[step]++;
  for (let k = 1; k < n; k++) counts[k] += counts[k - 1];
  return counts;
}

function sortedBy(columns, key, valid) {
  const order = columns[key].map((_, i) => i).filter(valid);
  order.sort((a, b) => columns[key][a] - columns[key][b] || a - b);
  return Object.fromEntries(Object.entries(columns).map(([name, list]) => [name, order.map((i) => list?.[i] ?? null)]));
}

// Edges of the map that are not one measurement, those of most first: fused, or composed of links of poses not kept.
function edgesOfSeveral(links, chain) {
  const pick = (edges, kind) => edges.from.map((from, i) => ({from, to: edges.to[i], kind, measurements: edges.measurements[i] ?? 1,
    ofLinks: !!edges.made_of_links[i], gain: edges.gain?.[i] ?? null})).filter((edge) => edge.measurements > 1 || edge.ofLinks);
  return [...pick(links, 'link'), ...pick(chain, 'odometry')].sort((a, b) => b.measurements - a.measurements || a.from - b.from || a.to - b.to);
}

// What poses were from which step on: [{pose, state, from, until}] in ascending order of `from`; state: kept, dropped,
// anchored (not kept, found again at a kept pose) or retired (kept once). Where the decisions do not lead to what is kept
// at the end, as of poses that no decision is known of, a pose was from its arrival on what it is at the end.
function spellsOf(run, kept, anchored, isPose) {
  const n = kept.length, {verdict = []} = run.poses, verdicts = run.verdicts ?? [];
  const states = Array.from({length: n}, (_, i) => {
    const why = verdicts[verdict[i]];
    const state = why === undefined ? (kept[i] ? 'kept' : 'dropped') : why === 'anchored' ? 'anchored' : why === 'redundant' ? 'dropped' : 'kept';
    return [{pose: i, state, from: i, until: Infinity}];
  });
  const change = (list, state, step) => (list ?? []).filter(isPose).forEach((i) => {
    states[i][states[i].length - 1].until = step;
    states[i].push({pose: i, state, from: step, until: Infinity});
  });
  for (let k = 0; k < n; k++) {
    change(run.decisions?.revived?.[k], 'kept', k);
    change(run.decisions?.retired?.[k], 'retired', k);
  }
  return states.map((list, i) => {
    if ((list[list.length - 1].state === 'kept') === !!kept[i]) return list.filter(({from, until}) => from < until);
    return [{pose: i, state: kept[i] ? 'kept' : anchored[i] ? 'anchored' : 'dropped', from: i, until: Infinity}];
  });
}

export const stateAt = (run, pose, step) => run.spellsOf[pose].find(({from, until}) => from <= step && step < until)?.state ?? null;

// counts[k]: of how many poses that is the state at step k.
function countsOfState(spells, state, n) {
  const counts = new Int32Array(n + 1);
  for (const spell of spells.filter((one) => one.state === state)) {
    counts[spell.from]++;
    counts[Math.min(spell.until, n)]--;
  }
  for (let k = 1; k < n; k++) counts[k] += counts[k - 1];
  return counts.subarray(0, n);
}

function readRun(run) {
  const {id} = run.poses;
  const n = id.length;
  const position = {x: orNaN(run.poses.x, n), y: orNaN(run.poses.y, n), z: orNaN(run.poses.z, n)};
  const hasTruth = !!run.truth?.x?.some(finite);
  const truth = hasTruth ? {x: orNaN(run.truth.x, n), y: orNaN(run.truth.y, n), z: orNaN(run.truth.z, n)} : null;
  const kept = Uint8Array.from({length: n}, (_, i) => (run.poses.kept?.[i] ? 1 : 0));
  const isPose = (i) => Number.isInteger(i) && i >= 0 && i < n;
  const {from = [], to = [], step, gain = [], innovation = [], measurements = [], made_of_links = []} = run.links ?? {};
  const at = from.map((_, i) => step?.[i] ?? Math.max(from[i], to[i]));
  const links = sortedBy({from, to, step: at, gain, innovation, measurements, made_of_links}, 'step', (i) => isPose(from[i]) && isPose(to[i]));
  const chainIn = {from: run.chain?.from ?? [], to: run.chain?.to ?? [], composed: run.chain?.composed ?? [],
    measurements: run.chain?.measurements ?? [], made_of_links: run.chain?.made_of_links ?? []};
  const chain = sortedBy(chainIn, 'to', (i) => isPose(chainIn.from[i]) && isPose(chainIn.to[i]));
  const covarianceIn = {pose: run.covariances?.pose ?? [], position: run.covariances?.position ?? []};
  const covariances = sortedBy(covarianceIn, 'pose',
    (i) => isPose(covarianceIn.pose[i]) && covarianceIn.position[i]?.every(finite));
  const anchoredTo = Array.from({length: n}, (_, i) => (isPose(run.decisions?.anchored_to?.[i]) ? run.decisions.anchored_to[i] : null));
  const anchored = Uint8Array.from(anchoredTo, (base, i) => (base !== null && !kept[i] ? 1 : 0));
  const spellsOfPoses = spellsOf(run, kept, anchored, isPose);
  const spells = spellsOfPoses.flat().sort((a, b) => a.from - b.from || a.pose - b.pose);
  return {
    name: String(run.name ?? 'run'), dimension: run.dimension === 2 ? 2 : 3, n, id, kept, position, truth, links, chain,
    covariances, verdict: run.poses.verdict ?? [], verdicts: run.verdicts ?? [],
    anchoredTo, anchored, ofSeveral: edgesOfSeveral(links, chain),
    spells, spellsOf: spellsOfPoses, everKept: Uint8Array.from(spellsOfPoses, (list) => (list.some(({state}) => state === 'kept') ? 1 : 0)),
    // The step of its retirement, of a pose that is retired at the end.
    retiredAt: spellsOfPoses.map((list) => (list[list.length - 1].state === 'retired' ? list[list.length - 1].from : null)),
    lastChange: spells.reduce((last, {state, from}) => (state === 'kept' || state === 'retired' ? Math.max(last, from) : last), 0),
    keptBy: countsOfState(spells, 'kept', n), droppedBy: countsOfState(spells, 'dropped', n),
    anchoredBy: countsOfState(spells, 'anchored', n), retiredBy: countsOfState(spells, 'retired', n),
    area: run.area?.explored?.length ? {cell: run.area.cell, explored: run.area.explored} : null,
    decisions: run.decisions ?? {}, steps: run.steps ?? {}, gate: run.gate, gateUnit: run.gate_unit,
    thresholds: run.thresholds ?? {}, stats: run.stats ?? {},
    indexOfId: new Map(id.map((value, i) => [value, i])),
    linksBy: countsByStep(links.step, n),
    covarianceOf: new Map(covariances.pose.map((pose, i) => [pose, covariances.position[i]])),
  };
}

// Smallest box around the finite positions of all runs: {min, max}, each [x, y, z].
export function boxOf(runs) {
  const min = [Infinity, Infinity, Infinity], max = [-Infinity, -Infinity, -Infinity];
  for (const run of runs) {
    ['x', 'y', 'z'].forEach((axis, k) => {
      for (const value of run.position[axis]) {
        if (value < min[k]) min[k] = value;
        if (value > max[k]) max[k] = value;
      }
    });
  }
  return min.every(finite) ? {min, max} : {min: [-1, -1, 0], max: [1, 1, 0]};
}

// The axis along which the runs extend least is vertical: z unless another is clearly smaller. Of y it is the negative
// direction that is up, as in a camera's coordinates.
export function verticalAxis(box) {
  const extent = box.max.map((value, k) => value - box.min[k]);
  let axis = 2;
  for (const k of [0, 1]) if (extent[k] < 0.9 * extent[axis]) axis = k;
  const up = [0, 0, 0], north = [0, 0, 0];
  up[axis] = axis === 1 ? -1 : 1;
  north[axis === 2 ? 1 : 2] = 1;  // what points up on the screen, seen from above
  return {axis, up, north};
}

// Which step of each run belongs to a position of the slider, 0 .. count - 1. By 'id': the last pose of an id not above
// that of the run that sets the pace, the one with most poses; by 'share' of the run.
export function align(runs, mode) {
  const pace = runs.reduce((best, run) => (run.n > best.n ? run : best), runs[0]);
  const count = Math.max(pace.n, 1);
  const indices = runs.map((run) => {
    const out = new Int32Array(count);
    for (let k = 0, i = 0; k < count; k++) {
      if (run === pace) {
        out[k] = k;
      } else if (mode === 'share') {
        out[k] = count > 1 ? Math.round((k / (count - 1)) * (run.n - 1)) : 0;
      } else {
        while (i + 1 < run.n && run.id[i + 1] <= pace.id[k]) i++;
        out[k] = i;
      }
    }
    return out;
  });
  return {mode, count, pace, indices};
}

// Whether two runs share most of their ids, in ascending order: then they are aligned by id.
export function shareIds(runs) {
  return runs.every((run) => {
    const common = run.id.filter((id) => runs[0].indexOfId.has(id)).length;
    return common > run.n / 2 && run.id.every((id, i) => i === 0 || id > run.id[i - 1]);
  });
}
