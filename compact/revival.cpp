#include "revival.h"

#include "chains.h"
#include "pose_recovery.h"

namespace terse::internal {
namespace {

// What others fused with the odometry that is split: it stays an edge by itself. nullptr if there is nothing.
template <class Pose>
const typename FusedEdges<Pose>::Edge* FusedWithReplaced(const Revival<Pose>& revival, const KeptLinks<Pose>& links) {
  const auto* edge = links.Edges().Find(FusedEdges<Pose>::Ordered(revival.base, *revival.next));
  return edge != nullptr && edge->factor == revival.replaced && edge->parts.size() >= 2 ? edge : nullptr;
}

// What joins the poses after the update.
template <class Pose>
void ReviveEdges(const Revival<Pose>& revival, const std::vector<FactorId>& ids, KeptLinks<Pose>& links) {
  links.AddOdometry(revival.base, revival.pose, ids[0]);
  if (!revival.next) return;
  links.AddOdometry(revival.pose, *revival.next, ids[1]);
  const auto ends = FusedEdges<Pose>::Ordered(revival.base, *revival.next);
  if (const auto* edge = FusedWithReplaced(revival, links)) {
    const std::vector<typename CompactMap<Pose>::Part> others(edge->parts.begin() + 1, edge->parts.end());
    links.SetEdge(ends, {revival.replaced, false, others}, ids[2], others.back().added_at);
  } else {
    links.ForgetEdge(ends, revival.replaced);
  }
}

// Whether the odometry between kept poses is what the chain between them measures, and no more: poses that retired
// (retire_poses.h) leave some that is more, and that what they knew of others hangs together with.
template <class Pose>
bool IsChainAlone(const UncertainPose<Pose>& T_base_next, const Revival<Pose>& revival,
                  const CompactParts<Pose>& parts) {
  const auto& factor = parts.map.Solver().Graph().FindFactor(revival.replaced)->factor;
  UncertainPose<Pose> odometry = SeenFrom(revival.base, std::get<RelativePoseFactor<Pose>>(factor));
  if (const auto* edge = FusedWithReplaced(revival, parts.links)) {
    const UncertainPose<Pose>& first = edge->parts.front().T_from_to;
    odometry = FusedEdges<Pose>::Ordered(revival.base, *revival.next).first == revival.base ? first : Invert(first);
  }
  const auto chain =
      SeenFrom(revival.base, Measurement(revival.base, *revival.next, T_base_next, parts.options.composition));
  return (odometry.covariance - chain.covariance).norm() <= 1e-6 * chain.covariance.norm();
}

}  // namespace

template <class Pose>
Revival<Pose> PlanRevivalOnChain(PoseId dropped, const CurrentPose<Pose>& current, const PoseHistory<Pose>& history) {
  const auto& seen = history.Find(dropped);
  return {dropped, seen.base, seen.T_base_pose, {}, std::nullopt, {}, *current.parent};
}

template <class Pose>
std::optional<Revival<Pose>> PlanRevival(PoseId dropped, const CompactParts<Pose>& parts) {
  const PoseHistory<Pose>& history = parts.history;
  const auto& seen = history.Find(dropped);
  if (seen.kept || !seen.next_kept || seen.ended_by >= 0) return std::nullopt;
  const auto behind = Behind(seen.T_base_pose, seen.T_base_next);
  const auto& next = history.Find(*seen.next_kept);
  const FactorNode<Pose>* node = parts.map.Solver().Graph().FindFactor(next.odometry);
  if (!behind || node == nullptr) return std::nullopt;
  const FactorPoses ends = PosesOf(node->factor);
  const bool joins =
      (ends.first == seen.base && ends.second == next.id) || (ends.second == seen.base && ends.first == next.id);
  if (!joins || next.parent < 0) return std::nullopt;
  const PoseId newest = history[next.parent].id;
  if (!history.IsPlainChain(dropped, newest, 1)) return std::nullopt;
  Revival<Pose> revival{dropped, seen.base, seen.T_base_pose, *behind, seen.next_kept, next.odometry, newest};
  if (!IsChainAlone(seen.T_base_next, revival, parts)) return std::nullopt;
  return revival;
}

template <class Pose>
void AddRevival(const Revival<Pose>& revival, const CompactParts<Pose>& parts, GraphUpdate<Pose>& update) {
  const CompositionOrder order = parts.options.composition;
  const Pose T_world_pose = PoseRecovery<Pose>(parts.history, parts.map).Estimate(revival.pose, Recovery::kV1);
  update.poses.push_back({revival.pose, T_world_pose, false});
  update.factors.push_back(Measurement(revival.base, revival.pose, revival.T_base_pose, order));
  update.odometry = {0};  // its factors are the first
  if (!revival.next) return;
  update.odometry.push_back(1);
  update.factors.push_back(Measurement(revival.pose, *revival.next, revival.T_pose_next, order));
  update.removed.push_back(revival.replaced);
  if (const auto* edge = FusedWithReplaced(revival, parts.links)) {
    const auto [first, second] = FusedEdges<Pose>::Ordered(revival.base, *revival.next);
    const std::vector<typename CompactMap<Pose>::Part> others(edge->parts.begin() + 1, edge->parts.end());
    update.factors.push_back(Measurement(first, second, FusedEdges<Pose>::Sum(others), CompositionOrder::kFirst));
  }
}

template <class Pose>
void Revive(const Revival<Pose>& revival, const std::vector<FactorId>& ids, CompactParts<Pose>& parts) {
  if (revival.next) parts.history.SetOdometry(*revival.next, ids[1]);
  ReviveEdges(revival, ids, parts.links);
  parts.history.Revive(revival, ids[0]);
}

#define TERSE_INSTANTIATE(Pose)                                                                          \
  template std::optional<Revival<Pose>> PlanRevival(PoseId, const CompactParts<Pose>&);                  \
  template Revival<Pose> PlanRevivalOnChain(PoseId, const CurrentPose<Pose>&, const PoseHistory<Pose>&); \
  template void AddRevival(const Revival<Pose>&, const CompactParts<Pose>&, GraphUpdate<Pose>&);         \
  template void Revive(const Revival<Pose>&, const std::vector<FactorId>&, CompactParts<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
