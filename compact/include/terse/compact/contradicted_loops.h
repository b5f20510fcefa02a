#pragma once
// Loops of a finished graph that are judged before a map is made of it.
//
// A map that grows hears of a loop once, when it comes, and what it refuses is no evidence for anything later. Where
// many loops are wrong, an early one that nothing contradicts yet bends the map, and true ones are refused for it. A
// file has all its loops at once: where a first map refuses many, all are judged by gnc (batch_solver.h), and those
// that it contradicts never come to the map that is made then.

#include <vector>

#include "terse/compact/compact_graph.h"
#include "terse/core/robust.h"

namespace terse {

// More than one link in a hundred, and not only one or two, was refused. Of maps of public graphs without wrong loops
// that refuse more than two none refuses over one in 160 (but sphere_bignoise's, which is lost); a tenth of wrong ones
// makes it one in fifteen, or, where most are never looked at, one in sixty with half of them wrong (parking-garage).
bool AreLoopsInDoubt(long refused, long offered);
template <class Pose>
bool AreLoopsInDoubt(const CompactRun<Pose>& run);

// Loops that the best explanation of all of them contradicts by far, ascending: with more than ten times the chi2 at
// which the kernel leaves a loop out. What is nearer the map judges for itself; slips of the odometry are not among
// them. Explanations are, in this order: the optimum of all loops next to that by gnc of odometry and of the loops that
// others near them bear out (two that agree over the odometry between their ends), which leaves few wrong ones in and
// the factor sparse; the optimum next to the first map; and, where true loops stand alone, that of the whole by gnc. A
// later one has to contradict no more loops than the best before it, and to have less chi2, of a loop no more than one
// true one in a hundred exceeds, or to explain one loop in twenty more. Of up to 500 loops, that of the
// whole by a kernel twice as wide is a last one, which has to do the latter at less chi2 as that kernel has it.
// `first`: a run over this graph, with kGnc (CompactOptions::solver.robust), which is the kernel here too;
// options.robust is not looked at. Throws std::invalid_argument as SolveBatch does.
template <class Pose>
std::vector<FactorId> ContradictedLoops(const PoseGraph<Pose>& graph, const CompactRun<Pose>& first,
                                        BatchOptions options = {});

// The same next to any values by pose index in place of the first map's, or to none, with the kernel of options.robust
// (kGnc), whose quantile is not looked at.
template <class Pose>
std::vector<FactorId> ContradictedLoops(const PoseGraph<Pose>& graph, std::vector<Pose> first, BatchOptions options);

}  // namespace terse
