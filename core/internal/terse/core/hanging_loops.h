#pragma once
// Loops that hold a part of the map in place with nothing but a long way of odometry beside them.
//
// Where odometry knows a displacement no better than to half a radian, a wrong loop in its place costs next to nothing
// and turns half of the map. Only odometry speaks against it, and not within the width of a kernel, which leaves room
// for true loops that are worse than others: ais2klinik, one wrong loop in 1614, 283 m at a cost of 2.2, where 99 of
// 100 true loops cost less than 0.4.

#include <optional>

#include "terse/core/batch_solver.h"

namespace terse::internal {

// Next to `solved`, an optimum with its factor: the one without such loops, if that costs less, by truncated least
// squares as wide as true loops are off; nothing if not. They are groups that lead from about one place to about one
// other, without which the rest does not know how the other place is turned, and which it contradicts by more than true
// loops are off by the variance factor that the optimum shows (its chi2 over its redundancy: Koch, Parameter Estimation
// and Hypothesis Testing, 1999, section 3.2.3). `options`: of `solved`, with the robust factors that were chosen. The
// graph is connected. Throws as SolveBatch does.
template <class Pose>
std::optional<BatchResult<Pose>> WithoutHangingLoops(const PoseGraph<Pose>& graph, const BatchResult<Pose>& solved,
                                                     const BatchOptions& options);

}  // namespace terse::internal
