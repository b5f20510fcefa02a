#pragma once
// Odometry and loops of a graph, by the order in which its poses arrive.

#include <unordered_map>

#include "terse/core/arrival.h"
#include "terse/covariance/information_scale.h"

namespace terse::internal {

class EdgeKinds {
 public:
  // Throws std::invalid_argument if the graph is not connected.
  template <class Pose>
  explicit EdgeKinds(const PoseGraph<Pose>& graph) {
    for (const auto& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
      for (const int pose : step.poses) {
        const long rank = static_cast<long>(rank_.size());
        rank_[graph.Poses()[static_cast<std::size_t>(pose)].id.value] = rank;
      }
    }
  }
  bool IsLoop(PoseId a, PoseId b) const { return std::abs(rank_.at(a.value) - rank_.at(b.value)) > 1; }

 private:
  std::unordered_map<std::int64_t, long> rank_;
};

template <class Pose>
typename Pose::Jacobian Scaled(const typename Pose::Jacobian& information, const KindScale& scale) {
  typename Pose::Tangent s = Pose::Tangent::Constant(1 / scale.translation);
  s.template tail<Pose::kDof - Pose::kDim>().setConstant(1 / scale.rotation);
  return s.asDiagonal() * information * s.asDiagonal();
}

}  // namespace terse::internal
