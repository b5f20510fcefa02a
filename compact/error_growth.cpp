#include "terse/compact/error_growth.h"

#include <algorithm>
#include <cmath>

#include "terse/compact/aligned_error.h"
#include "terse/compact/state_members.h"
#include "terse/core/at.h"
#include "terse/core/definite.h"
#include "terse/core/gauge.h"

namespace terse {
namespace {

using internal::At;

template <class Pose>
LinearFactor<Pose::kDof> LinearizeIn(const PoseGraph<Pose>& map, const Factor<Pose>& factor,
                                     const std::vector<Pose>& T_world_body) {
  const FactorPoses ends = PosesOf(factor);
  const int first = map.IndexOf(ends.first), second = map.IndexOf(ends.second);
  return Linearize(factor, first, ends.count == 2 ? second : -1, T_world_body[At(first)], T_world_body[At(second)]);
}

}  // namespace

template <class Pose>
Registration<Pose> Watched(const Registration<Pose>& registration, SeenLoops<Pose>& seen) {
  if (!registration) return nullptr;
  return [&registration, &seen](PoseId candidate, PoseId current) {
    auto link = registration(candidate, current);
    seen.tried.push_back(candidate);
    const bool joins = link && FindDefect<Pose>(*link).empty() && (link->from == candidate || link->to == candidate);
    if (joins) seen.measured.push_back({candidate, SeenFrom(candidate, *link)});
    return link;
  };
}

template <class Pose>
void ErrorGrowth<Pose>::Add(PoseId a, PoseId b, const UncertainPose<Pose>& T_a_b, double weight) {
  if (a == b || !(weight > 0)) return;
  const Jacobian covariance = b < a ? Invert(T_a_b).covariance : T_a_b.covariance;
  if (!IsDefinite<Pose::kDof>(covariance)) return;
  const Jacobian information = weight * InverseOfDefinite<Pose::kDof>(covariance);
  if (!information.allFinite()) return;
  Jacobian& sum = information_.try_emplace(std::minmax(a, b), Jacobian::Zero()).first->second;
  sum += (information + information.transpose()) / 2;
  evidence_ += weight;
}

template <class Pose>
void ErrorGrowth<Pose>::See(const SeenLoops<Pose>& seen, bool is_kept, int used, const Jacobian& link_covariance,
                            const IncrementalSolver<Pose>& solver) {
  const double before = evidence_;
  const auto add = [&](PoseId kept, const UncertainPose<Pose>& T_kept_pose, double weight) {
    if (!solver.Graph().HasPose(kept)) return;
    is_kept ? Add(kept, seen.pose, T_kept_pose, weight)
            : Add(seen.base, kept, Compose(seen.T_base_pose, Invert(T_kept_pose)), weight);
  };
  for (const auto& loop : seen.measured) add(loop.kept, loop.T_kept_pose, 1);
  tried_ += static_cast<double>(seen.tried.size());
  if (!seen.tried.empty()) measured_ += static_cast<double>(seen.measured.size());
  const Pose T_world_pose = solver.Estimate(seen.base) * seen.T_base_pose.T_a_b;
  for (const auto& [kept, probability] : seen.in_range) {
    if (kept == seen.base || std::count(seen.tried.begin(), seen.tried.end(), kept) != 0) continue;
    add(kept, {solver.Estimate(kept).Inverse() * T_world_pose, link_covariance}, probability * measured_ / tried_);
  }
  left_out_ += std::max(evidence_ - before - used, 0.0);
}

// A tenth more, or a fiftieth left out: a few loops in a row can be all that holds two parts of a map together. A look
// costs as much as solving the map a few times.
template <class Pose>
bool ErrorGrowth<Pose>::IsDue() const {
  return evidence_ > 1.1 * looked_at_ + 10 || left_out_ > 0.02 * evidence_ + 5;
}

template <class Pose>
double ErrorGrowth<Pose>::Passed() const {
  constexpr double kMany = 30;  // the first few tell nothing
  return std::log((evidence_ + kMany) / (looked_at_ + kMany));
}

template <class Pose>
std::optional<double> ErrorGrowth<Pose>::Growth(const IncrementalSolver<Pose>& solver,
                                                const std::function<bool(FactorId)>& is_link) {
  looked_at_ = evidence_;
  left_out_ = 0;
  const PoseGraph<Pose>& map = solver.Graph();
  const std::vector<Pose> T_world_body = solver.Estimates();
  std::vector<LinearFactor<Pose::kDof>> odometry = {Anchor(FindGauge(map, T_world_body))}, links;
  for (const auto& node : map.Poses()) {
    if (!node.fixed) continue;
    const Pose& T = T_world_body[At(map.IndexOf(node.id))];
    odometry.push_back(LinearizeIn<Pose>(map, FixedPosePrior(node.id, T), T_world_body));
  }
  for (const auto& node : map.Factors()) {
    (is_link(node.id) ? links : odometry).push_back(LinearizeIn<Pose>(map, node.factor, T_world_body));
  }
  std::vector<LinearFactor<Pose::kDof>> all = odometry;
  for (auto it = information_.begin(); it != information_.end();) {
    const auto& [ends, information] = *it;
    if (!map.HasPose(ends.first) || !map.HasPose(ends.second)) {
      it = information_.erase(it);
      continue;
    }
    const Pose& first = T_world_body[At(map.IndexOf(ends.first))];
    const Pose& second = T_world_body[At(map.IndexOf(ends.second))];
    const RelativePoseFactor<Pose> edge{ends.first, ends.second, first.Inverse() * second, information};
    all.push_back(LinearizeIn<Pose>(map, edge, T_world_body));
    ++it;
  }
  odometry.insert(odometry.end(), links.begin(), links.end());
  const auto compact = ExpectedAlignedError<Pose>(map, T_world_body, std::move(odometry));
  const auto whole = ExpectedAlignedError<Pose>(map, T_world_body, std::move(all));
  if (!compact || !whole) return std::nullopt;
  return std::sqrt(*compact / *whole);
}

template <class Pose>
template <class Archive>
void ErrorGrowth<Pose>::Serialize(Archive& archive) {
  auto& [information, evidence, looked_at, left_out, tried, measured] = *this;
  archive(information, evidence, looked_at, left_out, tried, measured);
  if constexpr (Archive::kReads) {
    for (const auto& [ends, matrix] : information) {
      if (!(ends.first < ends.second) || !matrix.allFinite() || !IsDefinite<Pose::kDof>(matrix))
        archive.Fail("information of a loop that is none");
    }
    const bool counts = evidence >= 0 && looked_at >= 0 && left_out >= 0 && tried > 0 && measured > 0 &&
                        std::isfinite(evidence + tried);
    if (!counts) archive.Fail("a count of loops that is none");
  }
}

#define TERSE_INSTANTIATE(Pose)                                                     \
  template class ErrorGrowth<Pose>;                                                 \
  template Registration<Pose> Watched(const Registration<Pose>&, SeenLoops<Pose>&); \
  template void ErrorGrowth<Pose>::Serialize(StateWriter&);                         \
  template void ErrorGrowth<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
