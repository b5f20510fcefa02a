#include "sample.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "terse/compact/innovation.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/error.h"
#include "terse/core/robust.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

// Gains below this are not told apart.
constexpr double kLeastGain = 0.05;
// Poses that join the map at once, at most: their chain is composed, not estimated, while their links are tested.
constexpr size_t kMostPending = 20;

double MostInnovation(const SampleOptions& options, int dof) {
  return options.innovation_quantile ? ChiSquareQuantile(*options.innovation_quantile, dof)
                                     : std::numeric_limits<double>::infinity();
}

// A number that looks drawn at random, always the same for a pose (Steele, Lea and Flood's SplitMix64).
std::uint64_t Rank(PoseId id) {
  auto x = static_cast<std::uint64_t>(id.value) + 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}

// Looked at and relinearised at every update, since they are few; to what covariances need, not estimates.
IncrementalOptions SolverOptions() {
  IncrementalOptions options;
  options.relinearize_interval = 1;
  options.relinearize_tolerance = 1e-3;
  options.propagation_tolerance = 1e-4;
  return options;
}

CovarianceOptions CovarianceCache() {
  CovarianceOptions options;
  options.cache_bytes = std::size_t{8} << 20;
  return options;
}

PoseId OtherEnd(PoseId pose, PoseId from, PoseId to) { return from == pose ? to : from; }

}  // namespace

template <class Pose>
Sample<Pose>::Sample(const SampleOptions& options, GraphReplay<Pose>& replay)
    : most_innovation_(MostInnovation(options, Pose::kDof)),
      Sigma_y_(replay.LinkCovariance()),
      registration_(replay.AsRegistration()),
      solver_(SolverOptions()),
      marginals_(solver_, CovarianceCache()) {}

// Which of the pose's links are looked at and which join the map: so many, or all if there are not as many.
template <class Pose>
typename Sample<Pose>::Drawn Sample<Pose>::Draw(const CompactInput<Pose>& input, bool look) {
  const std::vector<PoseId>& linkable = *input.linkable;
  std::vector<size_t> order(linkable.size());
  for (size_t k = 0; k < order.size(); ++k) order[k] = k;
  std::vector<size_t> seen, joining = order;
  if (look) {
    // Fisher and Yates.
    const size_t count = std::min(order.size(), At(kMostLoops));
    for (size_t k = 0; k < count && count < order.size(); ++k) {
      std::swap(order[k], order[k + engine_() % (order.size() - k)]);
    }
    seen.assign(order.begin(), order.begin() + static_cast<long>(count));
    std::sort(seen.begin(), seen.end());
  }
  if (joining.size() > At(kMostLinks)) {
    const auto lower = [&](size_t a, size_t b) {
      return std::pair(Rank(linkable[a]), a) < std::pair(Rank(linkable[b]), b);
    };
    std::nth_element(joining.begin(), joining.begin() + kMostLinks, joining.end(), lower);
    joining.resize(At(kMostLinks));
    std::sort(joining.begin(), joining.end());
  }
  Drawn drawn;
  for (size_t k = 0; k < linkable.size(); ++k) {
    const bool is_seen = std::binary_search(seen.begin(), seen.end(), k);
    const bool joins = std::binary_search(joining.begin(), joining.end(), k);
    if (!is_seen && !joins) continue;
    const auto link = registration_(linkable[k], input.id);
    if (!link) continue;
    if (is_seen) drawn.seen.push_back(*link);
    if (joins) drawn.joining.push_back(*link);
  }
  return drawn;
}

template <class Pose>
void Sample<Pose>::Add(const CompactInput<Pose>& input, bool look) {
  Pending pose;
  pose.input = &input;
  const bool moved = input.odometry.has_value();
  if (moved) {
    const PoseId previous = OtherEnd(input.id, input.odometry->from, input.odometry->to);
    if (look || pending_.empty() || pending_.back().input->id != previous) Flush();
    pose.T_root_pose = pose.T_previous_pose = SeenFrom(previous, *input.odometry);
    if (pending_.empty()) {
      root_ = previous;
    } else {
      pose.T_root_pose = Compose(pending_.back().T_root_pose, pose.T_previous_pose);
    }
    if (!IsFinite(pose.T_root_pose.T_a_b) || !pose.T_root_pose.covariance.allFinite()) {
      throw NumericalError("the odometry of pose " + std::to_string(input.id.value) + " leads beyond all numbers");
    }
  }
  Drawn drawn = Draw(input, look);
  if (look && moved) Look(pose, drawn.seen);
  if (!drawn.joining.empty()) {
    pose.share = static_cast<double>(drawn.joining.size()) / static_cast<double>(input.linkable->size());
  }
  pose.links = std::move(drawn.joining);
  pending_.push_back(std::move(pose));
  if (!moved || pending_.size() >= kMostPending || input.fixed || !input.priors.empty()) Flush();
}

// What the loops of the first pose after the root would tell.
template <class Pose>
void Sample<Pose>::Look(const Pending& pose, const std::vector<Link>& loops) {
  const PoseId id = pose.input->id;
  std::vector<PoseId> linked;
  linked.reserve(loops.size());
  for (const Link& link : loops) linked.push_back(OtherEnd(id, link.from, link.to));
  LoopGains<Pose> known(marginals_, solver_, root_, pose.T_root_pose, linked);
  std::vector<int> good;
  for (int k = 0; k < static_cast<int>(linked.size()); ++k) {
    const UncertainPose<Pose> measured = SeenFrom(linked[At(k)], loops[At(k)]);
    if (!IsTested() || InnovationDistance(known.Displacement(k), measured) <= most_innovation_) good.push_back(k);
  }
  const size_t offered = pose.input->linkable->size();
  const size_t all = loops.empty() ? 0 : (offered * good.size() + loops.size() / 2) / loops.size();
  if (good.size() < linked.size()) known.Keep(good);
  double least = InformationGain<Pose::kDof>(pose.T_root_pose.covariance, Sigma_y_);
  for (int k = 0; k < static_cast<int>(good.size()); ++k) {
    least = std::min(least, InformationGain<Pose::kDof>(known.Displacement(k).covariance, Sigma_y_));
  }
  pose_gains.push_back(least);
  loops_seen += static_cast<long>(good.size());
  const std::vector<double> gains = known.BestFirst(Sigma_y_, kLeastGain);
  loop_gains.insert(loop_gains.end(), gains.begin(), gains.end());
  // The loops that were not drawn would come last.
  if (all > gains.size()) loop_gains.insert(loop_gains.end(), all - gains.size(), gains.back());
}

// By the innovation test before any of the pending links. As much of a displacement's covariance as costs nothing is
// tried first.
template <class Pose>
void Sample<Pose>::RemoveRefused(size_t index) {
  Pending& pose = pending_[index];
  const PoseId id = pose.input->id;
  std::vector<char> good(pose.links.size(), 0);
  std::vector<size_t> doubtful;
  std::vector<PoseId> linked;
  for (size_t i = 0; i < pose.links.size(); ++i) {
    const PoseId other = OtherEnd(id, pose.links[i].from, pose.links[i].to);
    size_t at = index;
    while (at > 0 && pending_[at - 1].input->id != other) --at;
    UncertainPose<Pose> known = pose.T_root_pose;
    if (at > 0) {
      known = pose.T_previous_pose;
      for (size_t k = index; k-- > at;) known = Compose(pending_[k].T_previous_pose, known);
    } else {
      known.T_a_b = solver_.Estimate(other).Inverse() * (solver_.Estimate(root_) * known.T_a_b);
    }
    good[i] = InnovationDistance(known, SeenFrom(other, pose.links[i])) <= most_innovation_;
    if (good[i] || at > 0 || other == root_) continue;
    doubtful.push_back(i);
    linked.push_back(other);
  }
  if (!doubtful.empty()) {
    const LoopGains<Pose> known(marginals_, solver_, root_, pose.T_root_pose, linked);
    for (size_t k = 0; k < doubtful.size(); ++k) {
      const UncertainPose<Pose> measured = SeenFrom(linked[k], pose.links[doubtful[k]]);
      good[doubtful[k]] = InnovationDistance(known.Displacement(static_cast<int>(k)), measured) <= most_innovation_;
    }
  }
  size_t kept = 0;
  for (size_t i = 0; i < good.size(); ++i) {
    if (good[i]) pose.links[kept++] = pose.links[i];
  }
  refused += static_cast<long>(good.size() - kept);
  pose.links.resize(kept);
}

// The pending poses join the map.
template <class Pose>
void Sample<Pose>::Flush() {
  if (pending_.empty()) return;
  GraphUpdate<Pose> update;
  for (size_t k = 0; k < pending_.size(); ++k) {
    if (IsTested()) RemoveRefused(k);
    const Pending& pose = pending_[k];
    const CompactInput<Pose>& input = *pose.input;
    Pose start = input.T_world_body.value_or(Pose());
    if (input.odometry) {
      if (!input.fixed) start = solver_.Estimate(root_) * pose.T_root_pose.T_a_b;
      update.factors.push_back(*input.odometry);
    }
    update.poses.push_back({input.id, start, input.fixed});
    update.factors.insert(update.factors.end(), input.priors.begin(), input.priors.end());
    believed.insert(believed.end(), pose.links.begin(), pose.links.end());
    for (Link link : pose.links) {
      link.information /= pose.share;
      update.factors.push_back(link);
    }
    links += static_cast<long>(pose.links.size());
  }
  solver_.Update(update);
  pending_.clear();
}

template class Sample<SE2>;
template class Sample<SE3>;

}  // namespace terse
