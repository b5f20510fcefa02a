#pragma once
// How far the information of a graph with fewer poses is from the exact marginal of the graph it came from.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// KL(exact marginal of the kept poses || what `fewer` says of them), nats, both linear at these values:
//   1/2 (tr(Lambda Sigma) - ln det Lambda + ln det Sigma^-1 - dim)
// with Lambda the information of `fewer` and Sigma the covariance of its poses in `whole`. tr is a sum over the factors
// of `fewer`, -ln det Sigma = ln det H - ln det H_dd, d the poses that are not kept: no dense matrix. That minima
// differ is not in it. `T_world_body`: by pose index of `whole`; the poses of `fewer` are some of its poses, of every
// part the first at least. Infinite where `fewer` does not hold every pose; NumericalError where `whole` does not.
template <class Pose>
double DivergenceFromMarginal(const PoseGraph<Pose>& whole, const std::vector<Pose>& T_world_body,
                              const PoseGraph<Pose>& fewer);

}  // namespace terse::internal
