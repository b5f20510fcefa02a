#include "terse/core/cycle_test.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

#include "terse/core/robust.h"

namespace terse::internal {

constexpr double kNearLimit = 0.5;  // of loops that a scale does not need

template <class Pose>
void CycleTest<Pose>::Extend(const RelativePoseFactor<Pose>& odometry) {
  const Covariance covariance = odometry.information.llt().solve(Covariance::Identity());
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
  const Eigen::LLT<Covariance> llt(Ad * between * Ad.transpose() + covariance);
  if (llt.info() != Eigen::Success) return std::nullopt;
  // T Exp(d), d normal, holds for large d too: compared in the exponential chart.
  const typename Pose::Tangent error = ((a->second.T_start_pose * T_from_to).Inverse() * b->second.T_start_pose).Log();
  return error.dot(llt.solve(error));
}

template <class Pose>
std::optional<double> CycleTest<Pose>::Innovation(const RelativePoseFactor<Pose>& loop) const {
  return Innovation(loop.from, loop.to, loop.T_from_to, loop.information.llt().solve(Covariance::Identity()));
}

template <class Pose>
std::vector<FactorId> LoopsAgainstOdometry(const PoseGraph<Pose>& graph) {
  using Relative = RelativePoseFactor<Pose>;
  std::map<PoseId, PoseId> previous;  // of poses, by id
  for (const auto& node : graph.Poses()) previous[node.id] = PoseId{};
  for (auto it = previous.begin(), next = it; it != previous.end(); it = next) {
    if (++next != previous.end()) next->second = it->first;
  }
  std::map<PoseId, Relative> odometry;  // that brings a pose in
  std::vector<std::pair<FactorId, Relative>> loops;
  for (const auto& node : graph.Factors()) {
    const auto* factor = std::get_if<Relative>(&node.factor);
    if (factor == nullptr) continue;
    const bool is_odometry = previous[factor->to] == factor->from || previous[factor->from] == factor->to;
    if (is_odometry) odometry.emplace(std::max(factor->from, factor->to), *factor);
    if (!is_odometry) loops.emplace_back(node.id, *factor);
  }
  CycleTest<Pose> cycles;
  for (const auto& [to, factor] : odometry) cycles.Extend(factor);
  std::vector<std::optional<double>> innovations;
  const double width = DefaultRobustWidth(RobustKernel::kGnc, Pose::kDof), stated = width * width;
  for (const auto& entry : loops) {
    innovations.push_back(cycles.Innovation(entry.second));
    if (innovations.back()) cycles.Note(*innovations.back(), stated);
  }
  std::vector<FactorId> refused;
  for (std::size_t k = 0; k < loops.size(); ++k) {
    if (cycles.Refuses(innovations[k], kNearLimit)) refused.push_back(loops[k].first);
  }
  return refused;
}

#define TERSE_INSTANTIATE(Pose)   \
  template class CycleTest<Pose>; \
  template std::vector<FactorId> LoopsAgainstOdometry<Pose>(const PoseGraph<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
