#include "terse/core/cycle_test.h"

#include <cmath>

#include "terse/core/definite.h"

namespace terse::internal {

template <class Pose>
void CycleTest<Pose>::Extend(const RelativePoseFactor<Pose>& odometry) {
  const Covariance covariance = InverseOfDefinite<Pose::kDof>(odometry.information);
  const bool knows_from = links_.count(odometry.from) != 0, knows_to = links_.count(odometry.to) != 0;
  if (knows_from == knows_to ? odometry.from < odometry.to : knows_from) {
    Append(odometry.from, odometry.to, odometry.T_from_to, covariance);
  } else {
    const Covariance Ad = odometry.T_from_to.Adjoint();
    Append(odometry.to, odometry.from, odometry.T_from_to.Inverse(), Ad * covariance * Ad.transpose());
  }
}

template <class Pose>
void CycleTest<Pose>::Append(PoseId from, PoseId to, const Pose& T_from_to, const Covariance& covariance) {
  const auto it = links_.find(from);
  const bool is_unknown = it == links_.end(), continues = !is_unknown && from == newest_;
  Link link = continues ? it->second : Link{Pose(), Covariance::Zero(), ++chains_, ++arrivals_};
  if (is_unknown) links_.insert_or_assign(from, link);
  if (is_unknown || continues) {
    link.T_start_pose = link.T_start_pose * T_from_to;
    const Covariance Ad = link.T_start_pose.Adjoint();
    link.covariance += Ad * covariance * Ad.transpose();
  }
  link.arrival = ++arrivals_;
  links_.insert_or_assign(to, link);
  newest_ = to;
}

template <class Pose>
void CycleTest<Pose>::Break(PoseId pose) {
  const auto it = links_.find(pose);
  if (it == links_.end()) return;
  const std::int64_t chain = it->second.chain, arrival = it->second.arrival;
  ++chains_;
  if (pose == newest_) {
    it->second.chain = chains_;
    return;
  }
  for (auto& [id, link] : links_) {
    if (link.chain == chain && link.arrival >= arrival) link.chain = chains_;
  }
}

template <class Pose>
std::optional<double> CycleTest<Pose>::Innovation(PoseId from, PoseId to, const Pose& T_from_to,
                                                  const Covariance& covariance) const {
  const auto a = links_.find(from), b = links_.find(to);
  if (a == links_.end() || b == links_.end() || a->second.chain != b->second.chain) return std::nullopt;
  const Covariance Ad = b->second.T_start_pose.Inverse().Adjoint();
  const double sign = a->second.arrival < b->second.arrival ? 1 : -1;
  const Covariance between = sign * (b->second.covariance - a->second.covariance);
  // T Exp(d), d normal, holds for large d too: compared in the exponential chart.
  const typename Pose::Tangent error = ((a->second.T_start_pose * T_from_to).Inverse() * b->second.T_start_pose).Log();
  const double squared = MahalanobisSquared<Pose::kDof>(Ad * between * Ad.transpose() + covariance, error);
  if (std::isinf(squared)) return std::nullopt;
  return squared;
}

template <class Pose>
std::optional<double> CycleTest<Pose>::Innovation(const RelativePoseFactor<Pose>& loop) const {
  return Innovation(loop.from, loop.to, loop.T_from_to, InverseOfDefinite<Pose::kDof>(loop.information));
}

template class CycleTest<SE2>;
template class CycleTest<SE3>;

}  // namespace terse::internal
