#pragma once
// The baseline optimiser: the same cost and the same exact Jacobians in Ceres.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::bench {

struct TimeToCost {
  double seconds = -1;  // until chi2 was at or below the target; negative: never
  int iterations = 0;   // by then, or in all
  double chi2 = 0;      // by then, or at the end
};

// Levenberg-Marquardt with SPARSE_NORMAL_CHOLESKY on SuiteSparse, one thread, the first pose constant, analytic
// Jacobians and whitening worked out beforehand. The time is that of ceres::Solve alone, without building the problem.
// The better of two runs: from the default trust region, and from one that does not bind (Gauss-Newton while it works).
// Relative factors only.
template <class Pose>
TimeToCost CeresTimeToCost(const PoseGraph<Pose>& graph, const std::vector<Pose>& start, double target_chi2);

}  // namespace terse::bench
