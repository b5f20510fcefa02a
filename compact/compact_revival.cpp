// Dropped poses that come back: a composed edge of the odometry is split where a loop leads to.

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"

namespace terse {
namespace {

using internal::Behind;
using internal::Measurement;

}  // namespace

// Of a pose on the chain of the pose at hand.
template <class Pose>
internal::Revival<Pose> CompactPoseSlam<Pose>::PlanRevivalOnChain(PoseId dropped, const Current& current) const {
  const auto& seen = history_->Find(dropped);
  return {dropped, seen.base, seen.T_base_pose, {}, std::nullopt, {}, *current.parent};
}

// Absent for a pose that is kept, whose chain has not ended at a kept pose, or cannot be split.
template <class Pose>
std::optional<internal::Revival<Pose>> CompactPoseSlam<Pose>::PlanRevival(PoseId dropped) const {
  const auto& seen = history_->Find(dropped);
  if (seen.kept || !seen.next_kept || seen.ended_by >= 0) return std::nullopt;
  const auto behind = Behind(seen.T_base_pose, seen.T_base_next);
  const FactorId edge = history_->Find(*seen.next_kept).odometry;
  const FactorNode<Pose>* node = solver_->Graph().FindFactor(edge);
  if (!behind || node == nullptr) return std::nullopt;
  const FactorPoses ends = PosesOf(node->factor);
  const bool joins = (ends.first == seen.base && ends.second == *seen.next_kept) ||
                     (ends.second == seen.base && ends.first == *seen.next_kept);
  if (!joins) return std::nullopt;
  const PoseId newest = (*history_)[history_->Find(*seen.next_kept).parent].id;
  if (!history_->IsPlainChain(dropped, newest, 1)) return std::nullopt;
  return Revival{dropped, seen.base, seen.T_base_pose, *behind, seen.next_kept, edge, newest};
}

template <class Pose>
void CompactPoseSlam<Pose>::AddRevival(const Revival& revival, GraphUpdate<Pose>& update) const {
  update.poses.push_back({revival.pose, Estimate(revival.pose), false});
  update.factors.push_back(Measurement(revival.base, revival.pose, revival.T_base_pose, options_.composition));
  update.odometry = {0};  // its factors are the first
  if (!revival.next) return;
  update.odometry.push_back(1);
  update.factors.push_back(Measurement(revival.pose, *revival.next, revival.T_pose_next, options_.composition));
  update.removed.push_back(revival.replaced);
  // What fused with the odometry that is split stays an edge by itself.
  const auto* edge = fused_->Find(FusedEdges<Pose>::Ordered(revival.base, *revival.next));
  if (edge == nullptr || edge->factor != revival.replaced || edge->parts.size() < 2) return;
  const auto ends = FusedEdges<Pose>::Ordered(revival.base, *revival.next);
  const std::vector<typename CompactMap<Pose>::Part> others(edge->parts.begin() + 1, edge->parts.end());
  update.factors.push_back(
      Measurement(ends.first, ends.second, FusedEdges<Pose>::Sum(others), CompositionOrder::kFirst));
}

// What joins the poses after the update.
template <class Pose>
void CompactPoseSlam<Pose>::ReviveEdges(const Revival& revival, const std::vector<FactorId>& ids) {
  using Fused = FusedEdges<Pose>;
  if (options_.strategy != Strategy::kBounded) return;
  const bool fuses = options_.solver.robust.kernel == RobustKernel::kNone;  // with odometry (RememberEdge)
  if (fuses) fused_->Remember(Fused::Ordered(revival.base, revival.pose), ids[0], true);
  if (!revival.next) return;
  if (fuses) fused_->Remember(Fused::Ordered(revival.pose, *revival.next), ids[1], true);
  const auto ends = Fused::Ordered(revival.base, *revival.next);
  const auto* edge = fused_->Find(ends);
  if (edge == nullptr || edge->factor != revival.replaced) return;
  if (edge->parts.size() < 2) {
    fused_->Forget(ends, revival.replaced);
    return;
  }
  typename Fused::Edge others{ids[2], false, {edge->parts.begin() + 1, edge->parts.end()}};
  Link link{others.factor, others.parts.back().added_at, 0};
  for (const auto& part : others.parts) *link.gain += part.gain;
  links_.push_back(link);
  fused_->Set(ends, std::move(others));
}

// After the update: `ids` of its first factors.
template <class Pose>
void CompactPoseSlam<Pose>::Revive(const Revival& revival, const std::vector<FactorId>& ids) {
  if (revival.next) history_->SetOdometry(*revival.next, ids[1]);
  ReviveEdges(revival, ids);
  history_->Revive(revival, ids[0]);
}

#define TERSE_INSTANTIATE(Pose)                                                                             \
  template std::optional<internal::Revival<Pose>> CompactPoseSlam<Pose>::PlanRevival(PoseId) const;         \
  template internal::Revival<Pose> CompactPoseSlam<Pose>::PlanRevivalOnChain(PoseId, const Current&) const; \
  template void CompactPoseSlam<Pose>::AddRevival(const Revival&, GraphUpdate<Pose>&) const;                \
  template void CompactPoseSlam<Pose>::ReviveEdges(const Revival&, const std::vector<FactorId>&);           \
  template void CompactPoseSlam<Pose>::Revive(const Revival&, const std::vector<FactorId>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
