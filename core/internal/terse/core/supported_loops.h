#pragma once
// Loops that others near them bear out.
//
// Two true loops from about one place to about one other place close a cycle over short stretches of odometry, and it
// closes; a wrong loop seldom has a neighbour that is wrong in the same way (pairwise consistency: Mangelson et al.,
// ICRA 2018). A true loop that is alone has none either: without support is not wrong.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// Loops (robust.h) that agree with none of the others, up to 32 of them, whose ends lie within ten poses of theirs,
// ascending. O((V + E) log V), and all that lie near where many do.
template <class Pose>
std::vector<FactorId> UnsupportedLoops(const PoseGraph<Pose>& graph);

}  // namespace terse::internal
