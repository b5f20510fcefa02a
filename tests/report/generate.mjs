// Data of runs that nobody made, for the tests of the page: seeded, of any size, with the odd cases.

// Uniform in 0 .. 1 (mulberry32).
function random(seed) {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), state | 1);
    t = (t + Math.imul(t ^ (t >>> 7), t | 61)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

const kVerdicts = ['first', 'all_kept', 'loop_closed', 'prior', 'nothing_in_range', 'informative', 'redundant', 'drawn', 'anchored'];
const round = (x) => Number(x.toPrecision(7));

// Three laps around a wavy ring; every `keepEvery`-th pose is kept, with `links` links between kept poses, evenly spread: to
// where a lap or two before the place was passed, or else to poses shortly before.
export function makeRun({name = 'run', poses = 120, links = 40, keepEvery = 3, dimension = 3, truth = true, seed = 1, strategy = 'fpfl', down = null} = {}) {
  const uniform = random(seed);
  const n = poses, ids = Array.from({length: n}, (_, i) => 2 * i);
  const x = [], y = [], z = [];
  for (let i = 0; i < n; i++) {
    const angle = (6 * Math.PI * i) / n, radius = 20 + 4 * Math.sin(5 * angle) + (4 * i) / n;
    x.push(round(radius * Math.cos(angle)));
    y.push(round(0.7 * radius * Math.sin(angle)));
    z.push(dimension === 3 ? round(Math.sin(3 * angle) + (2 * i) / n) : 0);
  }
  const kept = ids.map((_, i) => (i % keepEvery === 0 ? 1 : 0));
  const keptList = ids.map((_, i) => i).filter((i) => kept[i]);
  const link = {from: [], to: [], step: [], gain: [], innovation: []};
  const candidates = ids.map(() => []);
  for (let k = 0; k < links && keptList.length > 2; k++) {
    const to = keptList[2 + Math.floor((k * (keptList.length - 2)) / links)];
    const lap = Math.floor((n / 3) * (1 + Math.floor(2 * uniform()))), back = to - lap > 0 ? lap : 2 * keepEvery;
    const from = keptList[Math.min(Math.max(Math.round((to - back) / keepEvery + 8 * (uniform() - 0.5)), 0), to / keepEvery - 1)];
    const gain = round(3 + 9 * uniform() ** 3), innovation = round(6 * uniform());
    link.from.push(from); link.to.push(to); link.step.push(to); link.gain.push(gain); link.innovation.push(innovation);
    candidates[to].push([from, round(uniform()), round(gain * (0.8 + 0.4 * uniform())), gain, 1, innovation]);
  }
  for (let i = 1; i < n; i++) candidates[i].push([keptList[Math.floor((keptList.length * i) / n / 2)], round(uniform()), round(2 * uniform()), null, 0, null]);
  const accepted = candidates.map((list) => list.filter((c) => c[4]).length);
  const sum = (list) => { let s = 0; return list.map((v) => (s += v)); };
  const posesBy = sum(kept), linksBy = sum(accepted), every = Math.max(1, Math.floor(n / 300));
  const sparse = (of) => ids.map((_, i) => (i % every === 0 ? of(i) : null));
  const stats = {poses: n, edges: n - 1 + 3 * links, loop_edges: 3 * links, chi2: round(100 * uniform()) + 1e-9, normalized_chi2: round(uniform()), converged: true, termination: 'converged',
    strategy, poses_kept: keptList.length, links_kept: links, links_offered: 3 * links, registrations_tried: 2 * links, links_refused: 0,
    thresholds: {dimension, probability: 0.1, min_loop_gain: 3, min_pose_gain: 5.4},
    seconds: {total: round(uniform()), read: round(0.01 * uniform())}, step_seconds: {median: 1.25e-5, p95: 3e-5, p99: 1.5e-4, max: 0.0003}, threads: 1, version: '0.1.0'};
  const position = (k) => {
    const s = 0.02 + (0.3 * k) / n;
    return dimension === 3 ? [s, 0.3 * s, 0, 0.5 * s, 0, 0.1 * s] : [s, 0.3 * s, 0, 0.5 * s, 0, 0];
  };
  const run = {name, dimension, poses: {id: ids, kept, verdict: ids.map((_, i) => (i === 0 ? 0 : !kept[i] ? 6 : accepted[i] ? 2 : 5)), x, y, z}, verdicts: kVerdicts,
    truth: truth ? {x: x.map((v) => round(v + 0.4 * uniform())), y: y.map((v) => round(v - 0.4 * uniform())), z} : null, links: link,
    chain: {from: keptList.slice(0, -1), to: keptList.slice(1), composed: keptList.slice(1).map(() => keepEvery - 1)},
    decisions: {pose_gain: ids.map((_, i) => (i === 0 ? null : round(kept[i] ? 5.4 + 3 * uniform() : 5 * uniform()))), registrations: accepted.map((a) => 2 * a), accepted, refused: ids.map(() => 0), candidates},
    covariances: {pose: keptList, position: keptList.map(position)},
    steps: {poses: posesBy, links: linksBy, gain: ids.map((_, i) => (accepted[i] ? Math.max(...candidates[i].filter((c) => c[4]).map((c) => c[3])) : null)),
      gate_open: ids.map((_, i) => (kept[i] ? (accepted[i] ? 1 : 0) : null)), gate_value: ids.map((_, i) => (kept[i] ? round(10 ** (-6 * uniform())) : null)),
      seconds: ids.map(() => round(1e-5 * (1 + uniform()))), hessian_nonzeros: sparse((i) => 40 * posesBy[i]), factor_nonzeros: sparse((i) => 60 * posesBy[i]), ate_m: truth ? sparse((i) => round(0.3 + 0.1 * Math.sin(i / n))) : ids.map(() => null)},
    gate: 'newton_decrement', gate_unit: 'share of chi2', thresholds: {dimension, range: dimension === 3 ? [5, 5, 5, 1] : [5, 5, 1], probability: 0.1, min_loop_gain: 3, min_pose_gain: 5.4}, stats};
  run.area = {cell: 5, explored: ids.map((_, i) => 25 * (1 + Math.min(Math.floor(i / 2), Math.floor(n / 6))))};
  if (down === 'y') [run.poses.y, run.poses.z] = [run.poses.z, run.poses.y];  // as seen by a camera
  return run;
}

// What may be absent is absent, and holes where there may be holes.
export function makeBareRun({name = 'bare', poses = 50} = {}) {
  const run = makeRun({name, poses, links: 12, truth: false});
  return {...run, truth: null, covariances: null, steps: null, decisions: {...run.decisions, candidates: []}, gate: null, gate_unit: null};
}

export function makeHolesRun({name = 'holes'} = {}) {
  const run = makeRun({name, poses: 90, links: 20});
  const holes = (list, stride) => list.map((value, i) => (i % stride === 1 ? null : value));
  run.poses.x = holes(run.poses.x, 17);
  run.truth = {x: holes(run.truth.x, 5), y: run.truth.y, z: run.truth.z};
  run.links.gain = holes(run.links.gain, 3);
  run.links.innovation = run.links.innovation.map(() => null);
  run.covariances.position[2] = [null, null, null, null, null, null];
  run.covariances.position[3] = [0, 0, 0, 0, 0, 0];
  run.steps.seconds = holes(run.steps.seconds, 4);
  run.steps.gain = run.steps.gain.map(() => null);
  run.stats.chi2 = null;
  run.stats.log_determinant = null;
  Object.assign(run.stats, {odd_frames: [], lost: [{frame: 3}], robust: {kernel: 'gnc', loops: [{from: 1, to: 2, weight: 0}]}});
  run.poses.verdict = [];
  run.decisions.candidates[4] = [[0, null, null, null, 0, null]];
  return run;
}

export const report = (...runs) => ({format: 'terse-report-1', version: '0.1.0', runs});

// A run by the strategy bounded: from the second lap on poses are found again at kept ones, and what their links measure fuses.
export function makeBoundedRun({name = 'bounded', poses = 120} = {}) {
  const run = makeRun({name, poses, links: 12, strategy: 'bounded'});
  const n = poses, keptList = run.poses.id.map((_, i) => i).filter((i) => run.poses.kept[i]);
  run.links.measurements = run.links.from.map((_, i) => (i === 3 ? 7 : 1));
  run.links.made_of_links = run.links.from.map((_, i) => (i === 3 || i === 5 ? 1 : 0));
  run.chain.measurements = run.chain.from.map((_, i) => (i === 4 ? 2 : 1));
  run.chain.made_of_links = run.chain.from.map((_, i) => (i === 4 ? 1 : 0));
  run.decisions.anchored_to = run.poses.id.map(() => null);
  run.decisions.edges = run.poses.id.map(() => []);
  let anchored = 0;
  for (let i = Math.floor(n / 3) + 1; i < n; i += 2) {
    if (run.poses.kept[i]) continue;
    const base = keptList[i % 5];
    run.poses.verdict[i] = 8;
    run.decisions.anchored_to[i] = base;
    run.decisions.candidates[i] = [[base, 0.9, 2, 2.5, 0, 1, 1, 1, 'anchors'], [keptList[6], 0.9, 1, 1.5, 0, 1, 1, 1, 'composed'], [keptList[7], 0.9, 1, 1.2, 0, 1, 0, 1]];
    if (anchored % 2 === 0) run.decisions.edges[i] = [[run.links.from[3], run.links.to[3], 0.4, 1]];
    ++anchored;
  }
  Object.assign(run.stats, {poses_anchored: anchored, edges_composed: 3, measurements_composed: 9, edges_fused: 2});
  return run;
}

// The same, of which poses retire: 18 and 24 at step 60, 30 at its end; 36 at step 60, which comes back at step 90. Pose 31
// was dropped and comes back at step 70.
export function makeRetiringRun({name = 'retiring'} = {}) {
  const run = makeBoundedRun({name}), n = run.poses.id.length;
  run.decisions.retired = run.poses.id.map((_, i) => (i === 60 ? [18, 24, 36] : i === n - 1 ? [30] : []));
  run.decisions.revived = run.poses.id.map((_, i) => (i === 70 ? [31] : i === 90 ? [36] : []));
  for (const i of [18, 24, 30]) run.poses.kept[i] = 0;
  run.poses.kept[31] = 1;
  const there = run.covariances.pose.map((i) => run.poses.kept[i] === 1);
  for (const key of ['pose', 'position']) run.covariances[key] = run.covariances[key].filter((_, k) => there[k]);
  run.steps.poses = run.steps.poses.map((count, k) => count - (k >= 60 ? 3 : 0) + (k >= 70 ? 1 : 0) + (k >= 90 ? 1 : 0));
  Object.assign(run.stats, {poses_kept: 38, poses_retired: 4, retired_loss_nats: 0.25});
  return run;
}

// As `terse report` fills the page in.
export function fill(page, data) {
  const mark = '"@TERSE_REPORT_DATA@"';
  if (page.split(mark).length !== 2) throw new Error(`the page is to hold ${mark} once`);
  return page.replace(mark, () => JSON.stringify(data).replace(/</g, '\\u003c'));
}
