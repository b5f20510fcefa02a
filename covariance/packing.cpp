#include "terse/covariance/packing.h"

#include <algorithm>
#include <stdexcept>

#include "terse/covariance/information_scale.h"

namespace terse {
namespace {

constexpr double kUnknownFactor = 0.01, kLeastFactor = 1e-6;

double FactorOf(const ScaleEstimate& odometry, const ScaleEstimate& loops) {
  if (!odometry.determined && !loops.determined) return kUnknownFactor;
  return std::clamp(std::min(odometry.sigma_factor, loops.sigma_factor), kLeastFactor, 1.0);
}

}  // namespace

template <class Pose>
PackedPrecision ChoosePacking(const PoseGraph<Pose>& graph, double share) {
  if (!(share > 0 && share <= 1))
    throw std::invalid_argument("the share of a standard deviation is above 0 and at most 1");
  const PackedPrecision unknown{share * kUnknownFactor, share * kUnknownFactor};
  if (ConnectedComponents(graph).size() != 1) return unknown;
  const InformationEstimate estimate = EstimateInformationScale(graph);
  if (!estimate.failure.empty()) return unknown;
  return {share * FactorOf(estimate.odometry.translation, estimate.loops.translation),
          share * FactorOf(estimate.odometry.rotation, estimate.loops.rotation)};
}
template PackedPrecision ChoosePacking<SE2>(const PoseGraph<SE2>&, double);
template PackedPrecision ChoosePacking<SE3>(const PoseGraph<SE3>&, double);

}  // namespace terse
