// The search of Algorithm 1: which kept poses may be linked to the pose at hand, and what the links would be worth.

#include <cmath>

#include "compact_pose_slam_parts.h"
#include "terse/compact/information.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

}  // namespace

// Makes the displacements from all kept poses to `base` ready (S, Eqs. 16-17). They hold until the factor changes; what
// hangs on base follows by composition. O(kept poses).
template <class Pose>
void CompactPoseSlam<Pose>::UpdateSearch(int base) {
  using Jacobian = typename Pose::Jacobian;
  if (searched_version_ == solver_->Factor().Version() && searched_base_ == base) return;
  UpdateCovariances();
  const std::vector<Jacobian>& marginal = marginals_->KeptMarginals();
  const int poses = static_cast<int>(marginal.size());
  // The base is the newest pose but where odometry starts from an older one.
  std::vector<Jacobian> column;
  if (base + 1 != poses) {
    std::vector<PoseId> ids;
    for (const auto& node : solver_->Graph().Poses()) ids.push_back(node.id);
    column = marginals_->Column(ids[At(base)], ids);
  }
  const Pose T_world_base = solver_->EstimateAt(base);
  // The covariances belong together where the factor is linearised.
  const std::vector<Pose>& points = solver_->LinearizationPoints();
  std::vector<typename PoseIndex<Pose>::Item> items;
  items.reserve(At(poses));
  T_pose_base_.resize(At(poses));
  for (int i = 0; i < poses; ++i) {
    const Pose T_world_pose = solver_->EstimateAt(i);
    UncertainPose<Pose>& displacement = T_pose_base_[At(i)];
    displacement = {};
    if (i != base) {
      displacement.T_a_b = T_world_pose.Inverse() * T_world_base;
      const Jacobian cross = column.empty() ? marginals_->KeptCross(i) : column[At(i)];
      const Pose T_point = points[At(i)].Inverse() * points[At(base)];
      displacement.covariance = MoveCovariance<Pose>(
          RelativeCovariance<Pose>(T_point, marginal[At(i)], cross, marginal[At(base)]), T_point, displacement.T_a_b);
    }
    items.push_back({T_world_pose.Translation(), Spread::Of<Pose>(displacement.covariance)});
  }
  reach_->Build(std::move(items));
  searched_version_ = solver_->Factor().Version();
  searched_base_ = base;
}

template <class Pose>
void CompactPoseSlam<Pose>::UpdateCovariances() {
  if (searches_) marginals_->Update();
}

// Kept poses that the distance test could accept: none that it accepts is missing. Ascending.
template <class Pose>
std::vector<int> CompactPoseSlam<Pose>::InReach(const Current& current) {
  searches_ = true;
  UpdateSearch(solver_->Graph().IndexOf(current.base));
  const auto& range = options_.range;
  const UncertainPose<Pose>& chain = current.T_base_current;
  const double length = chain.T_a_b.Translation().norm(), deviations = DeviationsBeyondRange(options_.probability);
  const Spread own = Spread::Of<Pose>(chain.covariance);
  const double most = range.template head<Pose::kDim>().norm(), root = std::sqrt(static_cast<double>(Pose::kDim));
  const auto reach = [&](const Spread& spread) { return most + root * deviations * spread.Behind(length, own).metres; };
  std::vector<int> out;
  reach_->VisitNear(current.T_world_body.Translation(), reach, [&](int i) {
    const Spread spread = reach_->Items()[At(i)].spread.Behind(length, own);
    const Pose T_pose_current = T_pose_base_[At(i)].T_a_b * chain.T_a_b;
    const auto mean = DisplacementMean<Pose>(T_pose_current, options_.distance);
    const bool near = (mean.template head<Pose::kDim>().cwiseAbs().array() <=
                       range.template head<Pose::kDim>().array() + deviations * spread.metres)
                          .all();
    if (!near) return;
    const double angle = AngleProbabilityBound(mean[Pose::kDim], spread.radians, range[Pose::kDim]);
    if (angle > options_.probability) out.push_back(i);
  });
  return out;
}

// The distance test and the gain of the given kept poses; those in range come back.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::Evaluated> CompactPoseSlam<Pose>::Evaluate(
    const Current& current, const std::vector<int>& poses) const {
  std::vector<Evaluated> out;
  for (const int i : poses) {
    Evaluated e;
    e.pose = i;
    e.T_pose_current = Compose(T_pose_base_[At(i)], current.T_base_current);
    const auto displacement = ComputeDisplacement<Pose>(e.T_pose_current, options_.distance);
    e.record.probability = RangeProbabilities<Pose>(displacement, options_.range).minCoeff();
    if (e.record.probability <= options_.probability) continue;
    e.record.id = solver_->Graph().Poses()[At(i)].id;
    e.record.gain = InformationGain<Pose::kDof>(e.T_pose_current.covariance, options_.link_covariance);
    out.push_back(e);
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                           \
  template void CompactPoseSlam<Pose>::UpdateCovariances();                               \
  template void CompactPoseSlam<Pose>::UpdateSearch(int);                                 \
  template std::vector<int> CompactPoseSlam<Pose>::InReach(const Current&);               \
  template std::vector<CompactPoseSlam<Pose>::Evaluated> CompactPoseSlam<Pose>::Evaluate( \
      const Current&, const std::vector<int>&) const;
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
