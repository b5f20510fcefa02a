#pragma once
// A start that uses position priors. Private to the library.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// How values were brought to the position priors: not at all, as one rigid body, or each stretch on its own.
enum class PositionStart { kAsComposed, kRigid, kPiecewise };

// Moves composed values to where the position priors say, in the way that leaves the least chi2 (fixed poses count as
// pose priors). Rigid: all of them together, as far as the priors determine that. Piecewise, for odometry that drifts
// by far more than the priors' noise: around every prior the stretch of the trajectory is taken that is long enough to
// tell how it is turned, laid over its priors, and poses between two priors go by both, each as far as it is near in
// order. `order` has all pose indices in order of arrival. O(factors), and O(priors times those in a stretch).
template <class Pose>
PositionStart MoveToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<int>& order,
                                   std::vector<Pose>& T_world_body);

}  // namespace terse::internal
