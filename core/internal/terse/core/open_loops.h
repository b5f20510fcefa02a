#pragma once
// Loops that a robust optimum leaves out though what it does not know would explain them.
//
// Next to an optimum a loop with a weight of zero stays out, however little the map knows of the displacement that it
// measures: nothing pulls. Whether it could be true is not told by its residual but by its innovation, which has the
// map's covariance in it.

#include <functional>
#include <vector>

#include "terse/core/batch_solver.h"

namespace terse::internal {

// Of the squared width of a kernel: a loop whose innovation is larger is wrong.
inline constexpr double kByFar = 10;

// Squared innovation of a loop that is out, at an optimum with its factor.
template <class Pose>
double InnovationOf(const RelativePoseFactor<Pose>& loop, const PoseGraph<Pose>& graph,
                    const BatchResult<Pose>& solved);

// Truncated least squares at these values by pose index; `robust` ascending.
template <class Pose>
double TruncatedCost(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                     const std::vector<FactorId>& robust, double width);

template <class Pose>
using IsBetter = std::function<bool(const BatchResult<Pose>& with, const BatchResult<Pose>& before)>;

// The optimum next to `T_world_body`, or the one next to it with loops that it left out though they are not wrong by
// far: all that agree with each other and with the map, if the caller finds that better, and as long as it does.
// `options.robust_factors` are to be given, and `options.graduate` not; its kernel is truncated least squares (kGnc) of
// the width given. Throws as SolveBatch does.
template <class Pose>
BatchResult<Pose> SolveWithOpenLoops(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                                     const BatchOptions& options, const IsBetter<Pose>& is_better);

}  // namespace terse::internal
