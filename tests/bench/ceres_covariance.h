#pragma once
// The baseline of batch covariances: all diagonal blocks by ceres::Covariance.

#include <optional>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::bench {

struct CeresCovarianceResult {
  double seconds = 0;     // of ceres::Covariance::Compute
  double difference = 0;  // the largest relative one (Frobenius) between its blocks and ours
};

// SPARSE_QR with SuiteSparseQR, one thread, the first pose anchored as ours is, tangent-space blocks at the values,
// whose perturbations are ours. The time is that of Compute alone. Runs in a process of its own, which is ended after
// `limit_seconds` of processor time: then, and where Ceres finds the Jacobian to be rank deficient, there is no result.
template <class Pose>
std::optional<CeresCovarianceResult> CeresCovariance(const PoseGraph<Pose>& graph, const std::vector<Pose>& values,
                                                     const std::vector<typename Pose::Jacobian>& ours,
                                                     int limit_seconds);

}  // namespace terse::bench
