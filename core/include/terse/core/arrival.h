#pragma once
// The order in which a stored graph would have come in online.
//
// Poses rank by ascending id, whatever their order in the graph. A pose arrives at its rank if a relative factor
// joins it to a pose that has arrived; otherwise it waits, and arrives in the step of the later pose that connects
// it. So the poses, read step after step, form an order in which every pose but the first is joined by a factor
// to an earlier one. A factor arrives with the last of its poses in that order. O((V + E) log V).

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

// Indices into PoseGraph::Poses() and PoseGraph::Factors().
struct ArrivalStep {
  std::vector<int> poses;
  std::vector<int> factors;
};

// kPose: a step is one pose (and those that waited for it, lowest id first as far as they are connected) with
// all factors that arrive with it, pose by pose. The first factor of a pose joins it to the closest earlier-ranked
// arrived pose (the closest later-ranked one if there is none), as odometry does; the others, priors included,
// keep the order of the graph. The first step is the first pose with its priors.
// kEdge: the same order with one factor in each step and the poses that it brings in; a pose's priors come after
// its relative factors. A first pose without priors comes in with the first relative factor.
enum class ArrivalUnit { kPose, kEdge };

// Every pose and every factor appears exactly once; no steps for an empty graph, and one step without factors for
// a single pose without priors. Throws std::invalid_argument if the graph is not connected.
template <class Pose>
std::vector<ArrivalStep> ArrivalSteps(const PoseGraph<Pose>& graph, ArrivalUnit unit);

}  // namespace terse
