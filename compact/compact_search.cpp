// The search of Algorithm 1: which kept poses may be linked to the pose at hand, and what the links would be worth.

#include <algorithm>
#include <cmath>

#include "compact_pose_slam_parts.h"
#include "terse/compact/information.h"
#include "terse/core/at.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

}  // namespace

// What the map knows of T_pose_base (Ila et al. 2017 Eqs. 16-17), of solver indices.
template <class Pose>
UncertainPose<Pose> CompactPoseSlam<Pose>::KnownDisplacement(int pose, int base) const {
  if (pose == base) return {};
  const auto& poses = solver_->Graph().Poses();
  const auto& marginal = marginals_->KeptMarginals();
  // The base is the newest pose but where odometry starts from an older one.
  const typename Pose::Jacobian cross = base + 1 == static_cast<int>(marginal.size())
                                            ? marginals_->KeptCross(pose)
                                            : marginals_->Column(poses[At(base)].id, {poses[At(pose)].id}).front();
  return DisplacementAt(pose, base, cross);
}

// The covariances belong together where the factor is linearised.
template <class Pose>
UncertainPose<Pose> CompactPoseSlam<Pose>::DisplacementAt(int pose, int base, const Jacobian& cross) const {
  const auto& marginal = marginals_->KeptMarginals();
  const std::vector<Pose>& points = solver_->LinearizationPoints();
  const Pose T_point = points[At(pose)].Inverse() * points[At(base)];
  const Pose T_pose_base = solver_->EstimateAt(pose).Inverse() * solver_->EstimateAt(base);
  return {T_pose_base,
          MoveCovariance<Pose>(terse::RelativeCovariance<Pose>(T_point, marginal[At(pose)], cross, marginal[At(base)]),
                               T_point, T_pose_base)};
}

// Makes the displacements from all kept poses to `base` ready. They hold until the factor changes; what hangs on base
// follows by composition. O(kept poses).
template <class Pose>
void CompactPoseSlam<Pose>::UpdateSearch(int base) {
  using Jacobian = typename Pose::Jacobian;
  if (searched_version_ == solver_->Cholesky().Version() && searched_base_ == base) return;
  UpdateCovariances();
  const std::vector<Jacobian>& marginal = marginals_->KeptMarginals();
  const int poses = static_cast<int>(marginal.size());
  std::vector<Jacobian> column;
  if (base + 1 != poses) {
    std::vector<PoseId> ids;
    for (const auto& node : solver_->Graph().Poses()) ids.push_back(node.id);
    column = marginals_->Column(ids[At(base)], ids);
  }
  std::vector<typename PoseIndex<Pose>::Item> items;
  items.reserve(At(poses));
  T_pose_base_.resize(At(poses));
  for (int i = 0; i < poses; ++i) {
    UncertainPose<Pose>& displacement = T_pose_base_[At(i)];
    displacement = i == base ? UncertainPose<Pose>()
                             : DisplacementAt(i, base, column.empty() ? marginals_->KeptCross(i) : column[At(i)]);
    items.push_back({solver_->EstimateAt(i).Translation(), Spread::Of<Pose>(displacement.covariance)});
  }
  reach_->Build(std::move(items));
  searched_version_ = solver_->Cholesky().Version();
  searched_base_ = base;
}

template <class Pose>
void CompactPoseSlam<Pose>::UpdateCovariances() {
  if (searches_) marginals_->Update();
}

// Kept poses that may be candidates: none that Evaluate takes for one is missing. Ascending. `plausible`: those too
// whose displacement is only plausibly within range.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::Ask> CompactPoseSlam<Pose>::InReach(const Current& current,
                                                                                bool plausible) {
  searches_ = true;
  UpdateSearch(solver_->Graph().IndexOf(current.base));
  const auto& range = options_.thresholds.range;
  const UncertainPose<Pose>& chain = current.T_base_current;
  const double length = chain.T_a_b.Translation().norm();
  // An ellipsoid reaches so many standard deviations in every direction.
  const double deviations =
      std::max(DeviationsBeyondRange(options_.thresholds.probability), plausible ? std::sqrt(most_distance_) : 0.0);
  const Spread own = Spread::Of<Pose>(chain.covariance);
  const double most = range.template head<Pose::kDim>().norm(), root = std::sqrt(static_cast<double>(Pose::kDim));
  const auto reach = [&](const Spread& spread) { return most + root * deviations * spread.Behind(length, own).metres; };
  std::vector<Ask> out;
  reach_->VisitNear(current.T_world_body.Translation(), reach, [&](int i) {
    const Spread spread = reach_->Items()[At(i)].spread.Behind(length, own);
    const Pose T_pose_current = T_pose_base_[At(i)].T_a_b * chain.T_a_b;
    const auto mean = DisplacementMean<Pose>(T_pose_current, options_.distance);
    const bool near = (mean.template head<Pose::kDim>().cwiseAbs().array() <=
                       range.template head<Pose::kDim>().array() + deviations * spread.metres)
                          .all();
    if (!near) return;
    const double angle = mean[Pose::kDim];
    const bool turned =
        AngleProbabilityBound(angle, spread.radians, range[Pose::kDim]) <= options_.thresholds.probability;
    if (turned && !(plausible && std::abs(angle) <= range[Pose::kDim] + deviations * spread.radians)) return;
    out.push_back({i, -1});
  });
  return out;
}

// What a loop that came with the pose tells if measured with Sigma_link, nats. One that was carried counts only by what
// it tells of the map: a pose that is lost little by little always learns from it where it is, and a map that kept
// every such pose would grow for ever. About the kept poses the loop and the chain that the pose hangs on are one
// measurement, with the sum of their covariances.
template <class Pose>
double CompactPoseSlam<Pose>::OfferGain(const Current& current, const Offer& offer, const UncertainPose<Pose>& known,
                                        const Jacobian& Sigma_link) const {
  if (offer.T_dropped_current) {
    return InformationGain<Pose::kDof>(offer.T_dropped_current->covariance, Sigma_link);
  }
  if (!offer.carried_from) return InformationGain<Pose::kDof>(known.covariance, Sigma_link);
  const Jacobian Sigma_y = Sigma_link + offer.carried;
  if (current.in_solver) return InformationGain<Pose::kDof>(known.covariance, Sigma_y);
  const Jacobian of_map = known.covariance - current.T_base_current.covariance;
  return InformationGain<Pose::kDof>(of_map, Sigma_y + current.T_base_current.covariance);
}

// What is known of the given kept poses, and what trying them promises. Of those that are to be registered only the
// candidates come back: within range with enough probability, or plausibly so if that is enough.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::Evaluated> CompactPoseSlam<Pose>::Evaluate(const Current& current,
                                                                                       const std::vector<Ask>& asks,
                                                                                       bool plausible) const {
  const int base = solver_->Graph().IndexOf(current.base);
  const bool is_ready = searched_version_ == solver_->Cholesky().Version() && searched_base_ == base;
  std::vector<Evaluated> out;
  for (const Ask& ask : asks) {
    Evaluated e;
    e.ask = ask;
    const Offer* offer = ask.offer >= 0 ? &current.offers[At(ask.offer)] : nullptr;
    e.T_pose_current =
        Compose(is_ready ? T_pose_base_[At(ask.pose)] : KnownDisplacement(ask.pose, base), current.T_base_current);
    const auto displacement = ComputeDisplacement<Pose>(e.T_pose_current, options_.distance);
    const auto within = RangeProbabilities<Pose>(displacement, options_.thresholds.range);
    e.record.probability = within.minCoeff();
    e.record.id = solver_->Graph().Poses()[At(ask.pose)].id;
    const bool is_candidate =
        e.record.probability > options_.thresholds.probability ||
        (plausible && DistanceToRange<Pose>(displacement, options_.thresholds.range, most_distance_) <= most_distance_);
    if (offer != nullptr) {
      e.plausible = is_candidate;
      e.record.measured = true;
      e.record.carried_from = offer->carried_from;
      e.record.gain = OfferGain(current, *offer, e.T_pose_current, options_.thresholds.link_covariance);
      e.worth = e.record.gain;
    } else {
      if (!is_candidate) continue;
      e.record.gain = InformationGain<Pose::kDof>(e.T_pose_current.covariance, options_.thresholds.link_covariance);
      e.worth = within.prod() * e.record.gain;
    }
    out.push_back(std::move(e));
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                              \
  template void CompactPoseSlam<Pose>::UpdateCovariances();                                                  \
  template UncertainPose<Pose> CompactPoseSlam<Pose>::KnownDisplacement(int, int) const;                     \
  template UncertainPose<Pose> CompactPoseSlam<Pose>::DisplacementAt(int, int, const Jacobian&) const;       \
  template void CompactPoseSlam<Pose>::UpdateSearch(int);                                                    \
  template double CompactPoseSlam<Pose>::OfferGain(const Current&, const Offer&, const UncertainPose<Pose>&, \
                                                   const Jacobian&) const;                                   \
  template std::vector<CompactPoseSlam<Pose>::Ask> CompactPoseSlam<Pose>::InReach(const Current&, bool);     \
  template std::vector<CompactPoseSlam<Pose>::Evaluated> CompactPoseSlam<Pose>::Evaluate(                    \
      const Current&, const std::vector<Ask>&, bool) const;
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
