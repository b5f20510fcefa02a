// Decisions in words.

import {isNumber} from './data.js';
import {integer, number, plural} from './format.js';

const kShort = {
  first: 'first pose', all_kept: 'all poses are kept', loop_closed: 'a loop closes', prior: 'it has a prior',
  nothing_in_range: 'nothing in range', informative: 'informative', redundant: 'redundant', drawn: 'drawn by lot',
  anchored: 'found again',
};

export const nats = (x) => (isNumber(x) ? `${number(x, 3)} nats` : 'an unknown gain');

export function verdictOf(run, k) {
  return run.verdicts[run.verdict[k]] ?? null;
}

export function verdictInShort(run, k) {
  const verdict = verdictOf(run, k);
  if (verdict === 'redundant' && run.everKept[k]) return 'back for a later loop';
  if (verdict === 'redundant' && run.stats.strategy === 'rfpfl') return 'not drawn';
  return kShort[verdict] ?? verdict ?? '';
}

export function fate(run, k) {
  const why = verdictInShort(run, k), retired = run.retiredAt[k];
  return `${run.everKept[k] ? 'kept' : 'dropped'}${why ? `: ${why}` : ''}${retired === null ? '' : `; retired at pose ${run.id[retired]}`}`;
}

// Some sentences on why pose k was kept or dropped, and on what became of it.
export function explain(run, k) {
  const retired = run.retiredAt[k];
  if (retired === null) return explainVerdict(run, k);
  return `${explainVerdict(run, k)} It retired at the step of pose ${run.id[retired]}: the map knows the place well enough without it, and what was measured at it went into measurements between its neighbours.`;
}

function explainVerdict(run, k) {
  const verdict = verdictOf(run, k);
  const gain = run.decisions.pose_gain?.[k], threshold = run.thresholds.min_pose_gain;
  const accepted = run.decisions.accepted?.[k] ?? 0, tried = run.decisions.registrations?.[k] ?? 0;
  switch (verdict) {
    case 'first': return 'The first pose holds the map in its place.';
    case 'all_kept': return 'This strategy keeps every pose, whatever it tells.';
    case 'loop_closed':
      if (run.stats.strategy === 'apal') return `${plural(accepted, 'link')} to earlier poses ${accepted === 1 ? 'was' : 'were'} measured here, and this strategy takes all.`;
      return `${plural(accepted, 'link')} of ${plural(tried, 'registration')} told enough about the map to be accepted, so the pose stays with ${accepted === 1 ? 'it' : 'them'}.`;
    case 'prior': return 'A prior, such as a position fix, or a held value ties this pose to the world.';
    case 'nothing_in_range': return 'No kept pose is likely to be in sensor range: without this one, a later visit would find nothing here.';
    case 'informative':
      return `Even the least informative link to a kept pose would bring ${nats(gain)}, more than the threshold of ${nats(threshold)}: the place is not known well enough from the poses around.`;
    case 'redundant':
      if (run.everKept[k]) return 'It was dropped at first. A later loop led to it and told more than could be carried along its odometry, so it came back into the map.';
      if (run.stats.strategy === 'rfpfl') return 'The lot did not fall on this pose; its odometry goes into that of the next kept one.';
      return `The least informative link to a kept pose would bring only ${nats(gain)}, not more than the threshold of ${nats(threshold)}: the kept poses know this place already. Its odometry goes into that of the next kept pose.`;
    case 'anchored': return explainAnchored(run, k);
    case 'drawn': return 'The lot fell on this pose: strategy rfpfl keeps poses at random.';
    default: return run.everKept[k] ? 'The pose is part of the map.' : 'The pose is not part of the map; its place is recovered from the kept poses around it.';
  }
}

// "made of 7 measurements", of an edge between kept poses.
export function madeOf({measurements, ofLinks}) {
  const what = ofLinks ? ' composed of links' : '';
  return measurements > 1 ? `made of ${integer(measurements)} measurements` : `one measurement${what}`;
}

const between = (run, from, to) => `${run.id[from] ?? 'unknown'} – ${run.id[to] ?? 'unknown'}`;

// What the links of step k made: [{edge, words}], words with what the edge is by the end of the run.
export function composedAt(run, k) {
  return (run.decisions.edges?.[k] ?? []).map(([from, to, gain, fused]) => {
    const now = run.ofSeveral.find((edge) => (edge.from === from && edge.to === to) || (edge.from === to && edge.to === from));
    const became = fused ? 'fused with the edge that joined the two already' : 'a new edge';
    return {edge: between(run, from, to), words: `${became}: ${nats(gain)} about the map${now ? `; by the end the edge is ${madeOf(now)}` : ''}`};
  });
}

function explainAnchored(run, k) {
  const base = run.anchoredTo[k], made = run.decisions.edges?.[k]?.length ?? 0;
  if (run.everKept[k]) return 'It was found again at first. A later loop led to it and told more than could be carried along its chain, so it came back into the map.';
  return `A link found the robot in known terrain: its chain starts anew at kept pose ${base === null ? 'unknown' : run.id[base]}, with the link's own precision, and the pose is not kept. `
    + (made > 0 ? `Together with the chain or with each other, further links made ${plural(made, 'measurement')} between kept poses.` : 'Its links told the map too little for an edge between kept poses.');
}

const kMostNamed = 12;

// "3, 17 and 4 more"
function named(run, poses) {
  const ids = poses.slice(0, kMostNamed).map((i) => run.id[i] ?? 'unknown').join(', ');
  return poses.length > kMostNamed ? `${ids} and ${integer(poses.length - kMostNamed)} more` : ids;
}

// Sentences on which other poses came back into the map and which retired from it at step k.
export function othersAt(run, k) {
  const revived = run.decisions.revived?.[k] ?? [], retired = run.decisions.retired?.[k] ?? [];
  return [
    revived.length > 0 && `${plural(revived.length, 'pose')} came back into the map, because a loop led there: ${named(run, revived)}.`,
    retired.length > 0 && `${plural(retired.length, 'pose')} retired, which the map can do without: ${named(run, retired)}.`,
  ].filter(Boolean);
}

const kNoLink = {word: 'the file has no such link', why: 'in range, but no edge of the file joins the two poses'};
// In a replay the registration is the file, from images it is the verifier.
const failed = (run) => (run.stats.frames === undefined ? kNoLink
  : {word: 'registration failed', why: 'asked for, but the images of the two poses gave no motion'});

// What became of a candidate [pose, probability, gain, measured, accepted, innovation, tried, came]: {word, why}; came: it is a
// loop that came with the pose. Runs of before did not say what was tried, or what came.
export function outcome(run, candidate) {
  const [, , gain, measured, accepted, innovation, tried, came] = candidate;
  const threshold = run.thresholds.min_loop_gain;
  const kRoles = {anchors: {word: 'found again', why: 'the chain starts anew with this link, which is no edge of the map'},
    composed: {word: 'composed', why: 'it is part of a measurement between kept poses'}};
  if (kRoles[candidate[8]]) return kRoles[candidate[8]];
  if (accepted) return {word: 'accepted', why: 'linked'};
  if (!isNumber(measured)) {
    if (came === 0 && run.stats.frames === undefined) return kNoLink;
    const low = isNumber(gain) && isNumber(threshold) && gain <= threshold && gain > 0;
    if (low && !tried) return {word: 'too little gain', why: `expected ${nats(gain)}, at most the threshold of ${nats(threshold)}: not registered`};
    return tried === 0 ? {word: 'not registered', why: 'others came first, and after them it was not worth it'} : failed(run);
  }
  if (isNumber(threshold) && measured <= threshold) {
    return {word: 'too little gain', why: `measured ${nats(measured)}, at most the threshold of ${nats(threshold)}`};
  }
  if (isNumber(innovation)) return {word: 'refused', why: `innovation ${number(innovation, 3)} is larger than a correct link's would be`};
  return {word: 'not accepted', why: 'the map did not take it'};
}

export function titleOf(run) {
  const kept = run.keptBy[run.n - 1] ?? 0, links = run.linksBy[run.n - 1] ?? 0;
  const offered = run.stats.links_offered;
  const of = isNumber(offered) ? ` of ${integer(offered)}` : '';
  const anchored = run.anchoredBy[run.n - 1] ?? 0;
  const again = anchored > 0 ? `; ${plural(anchored, 'pose was', 'poses were')} found again at kept ones` : '';
  const gone = (run.decisions.retired ?? []).reduce((sum, list) => sum + list.length, 0);  // some may have come back
  const retired = gone > 0 ? `; ${plural(gone, 'pose')} retired after a time in the map` : '';
  return {
    short: `${integer(kept)}\u202f/\u202f${integer(run.n)} poses, ${plural(links, 'link')}`,
    long: `keeps ${integer(kept)} of ${plural(run.n, 'pose')} and ${integer(links)}${of} ${links === 1 && !of ? 'link' : 'links'} beside the odometry${again}${retired}`,
  };
}
