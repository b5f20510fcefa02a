#pragma once
// Loops of a finished graph that are judged before a map is made of it.
//
// A map that grows hears of a loop once, when it comes, and what it refuses is no evidence for anything later. Where
// many loops are wrong, an early one that nothing contradicts yet bends the map, and true ones are refused for it. A
// file has all its loops at once: where a first map refuses many, all are judged by gnc at the optimum of the whole
// (batch_solver.h), and those that it contradicts never come to the map that is made then.

#include <vector>

#include "terse/compact/compact_graph.h"

namespace terse {

// More than one link in fifty, and not only one or two, was refused. Maps of public graphs without wrong loops refuse
// one in two hundred or less (but for kitti_02, two of 43, and sphere_bignoise, which is lost); a tenth of wrong ones
// makes it one in fifteen.
template <class Pose>
bool AreLoopsInDoubt(const CompactRun<Pose>& run);

// Loops that the optimum of the whole under gnc contradicts by far, ascending: beyond ten times the kernel's width.
// What is nearer the map judges for itself; slips of the odometry are not among them. None if the trajectory of the
// first map contradicts no more loops so: gnc, too, can be deceived, as by one wrong offset again and again. Takes as
// long as that solution does, some ten times what the map takes with half of the loops wrong. `first`: a run over this
// graph, with kGnc (CompactOptions::solver.robust), which is the kernel here too; options.robust is not looked at.
// Throws std::invalid_argument as SolveBatch does.
template <class Pose>
std::vector<FactorId> ContradictedLoops(const PoseGraph<Pose>& graph, const CompactRun<Pose>& first,
                                        BatchOptions options = {});

// A copy without these factors, the others under their ids.
template <class Pose>
PoseGraph<Pose> WithoutFactors(PoseGraph<Pose> graph, const std::vector<FactorId>& ids);

}  // namespace terse
