#include "candidate_search.h"

#include <algorithm>
#include <cmath>

#include "terse/compact/information.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"

namespace terse::internal {

template <class Pose>
void CandidateSearch<Pose>::TakeOptions() {
  most_distance_ = ChiSquareQuantile(options_.plausible_quantile, Displacement<Pose>::kSize);
}

// What the map knows of T_pose_base (Ila et al. 2017 Eqs. 16-17), of solver indices.
template <class Pose>
UncertainPose<Pose> CandidateSearch<Pose>::KnownDisplacement(int pose, int base) const {
  if (pose == base) return {};
  const auto& poses = map_.Solver().Graph().Poses();
  const IncrementalMarginals<Pose>& marginals = map_.Marginals();
  // The base is the newest pose but where odometry starts from an older one.
  const Jacobian cross = base + 1 == static_cast<int>(marginals.KeptMarginals().size())
                             ? marginals.KeptCross(pose)
                             : marginals.Column(poses[At(base)].id, {poses[At(pose)].id}).front();
  return DisplacementAt(pose, base, cross);
}

// The covariances belong together where the factor is linearised.
template <class Pose>
UncertainPose<Pose> CandidateSearch<Pose>::DisplacementAt(int pose, int base, const Jacobian& cross) const {
  const IncrementalSolver<Pose>& solver = map_.Solver();
  const auto& marginal = map_.Marginals().KeptMarginals();
  const std::vector<Pose>& points = solver.LinearizationPoints();
  const Pose T_point = points[At(pose)].Inverse() * points[At(base)];
  const Pose T_pose_base = solver.EstimateAt(pose).Inverse() * solver.EstimateAt(base);
  return {T_pose_base,
          MoveCovariance<Pose>(RelativeCovariance<Pose>(T_point, marginal[At(pose)], cross, marginal[At(base)]),
                               T_point, T_pose_base)};
}

template <class Pose>
void CandidateSearch<Pose>::MakeReady(int base) {
  if (IsReady(base)) return;
  map_.UpdateCovariances();
  const IncrementalSolver<Pose>& solver = map_.Solver();
  const IncrementalMarginals<Pose>& marginals = map_.Marginals();
  const int poses = static_cast<int>(marginals.KeptMarginals().size());
  std::vector<Jacobian> column;
  if (base + 1 != poses) {
    std::vector<PoseId> ids;
    for (const auto& node : solver.Graph().Poses()) ids.push_back(node.id);
    column = marginals.Column(ids[At(base)], ids);
  }
  std::vector<typename PoseIndex<Pose>::Item> items;
  items.reserve(At(poses));
  T_pose_base_.resize(At(poses));
  for (int i = 0; i < poses; ++i) {
    UncertainPose<Pose>& displacement = T_pose_base_[At(i)];
    displacement = i == base ? UncertainPose<Pose>()
                             : DisplacementAt(i, base, column.empty() ? marginals.KeptCross(i) : column[At(i)]);
    items.push_back({solver.EstimateAt(i).Translation(), Spread::Of<Pose>(displacement.covariance)});
  }
  reach_.Build(std::move(items));
  version_ = solver.Cholesky().Version();
  base_ = base;
}

template <class Pose>
std::vector<Ask> CandidateSearch<Pose>::InReach(const CurrentPose<Pose>& current, bool plausible) {
  map_.KeepCovariances(true);
  MakeReady(map_.Solver().Graph().IndexOf(current.base));
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
  reach_.VisitNear(current.T_world_body.Translation(), reach, [&](int i) {
    const Spread spread = reach_.Items()[At(i)].spread.Behind(length, own);
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

template <class Pose>
std::vector<Evaluated<Pose>> CandidateSearch<Pose>::Evaluate(const CurrentPose<Pose>& current,
                                                             const std::vector<Ask>& asks, bool plausible) const {
  const int base = map_.Solver().Graph().IndexOf(current.base);
  const bool is_ready = IsReady(base);
  std::vector<Evaluated<Pose>> out;
  for (const Ask& ask : asks) {
    Evaluated<Pose> e;
    e.ask = ask;
    e.T_pose_current =
        Compose(is_ready ? T_pose_base_[At(ask.pose)] : KnownDisplacement(ask.pose, base), current.T_base_current);
    const auto displacement = ComputeDisplacement<Pose>(e.T_pose_current, options_.distance);
    const auto within = RangeProbabilities<Pose>(displacement, options_.thresholds.range);
    e.record.probability = within.minCoeff();
    e.record.id = map_.Solver().Graph().Poses()[At(ask.pose)].id;
    const bool is_candidate =
        e.record.probability > options_.thresholds.probability ||
        (plausible && DistanceToRange<Pose>(displacement, options_.thresholds.range, most_distance_) <= most_distance_);
    if (ask.offer >= 0) {
      const Offer<Pose>& offer = current.offers[At(ask.offer)];
      e.plausible = is_candidate;
      e.record.measured = !offer.registered;
      e.record.carried_from = offer.carried_from;
      e.record.gain = OfferGain(offer, current, e.T_pose_current, options_.thresholds.link_covariance);
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

template <class Pose>
Evaluated<Pose> CandidateSearch<Pose>::EvaluateOffer(const CurrentPose<Pose>& current, int offer) const {
  const int pose = map_.Solver().Graph().IndexOf(current.offers[At(offer)].kept);
  return Evaluate(current, {{pose, offer}}, true).front();
}

template class CandidateSearch<SE2>;
template class CandidateSearch<SE3>;

}  // namespace terse::internal
