#pragma once
// How probable measurements are under scales of their information and a choice of wrong loops.

#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/covariance/information_probe.h"

namespace terse::internal {

// -log of the probability of the measurements, the poses integrated out (Laplace's approximation: MacKay, Neural
// Computation 4(3), 1992), but for what is the same under any scales of the same graph. `terms`: scaled, in the order
// of the graph's factors, of which `loops` are those that may be wrong. `solved`: the optimum with weights; what has
// weight below a half is wrong. A wrong loop says anything in the range of what all loops say, but a group of wrong
// ones is one mistake: the others of it are as likely as the short cycles that they close with it.
template <class Pose>
double CostOfScales(const std::vector<ProbeTerm<Pose>>& terms, const std::vector<char>& is_loop,
                    const BatchResult<Pose>& solved);

// No choice of wrong loops and no residuals make it less: a loop is foretold no better than it measures. Nothing
// (-infinity) is known unless odometry, what is no loop, goes from each pose to the next exactly once. O(E).
template <class Pose>
double LeastCostOfScales(const std::vector<ProbeTerm<Pose>>& terms, const std::vector<char>& is_loop);

}  // namespace terse::internal
