// Dropped poses that come back: a composed edge of the odometry is split where a loop leads to.
//
// Covariances of a chain add up (Sigma_bc = Ad(T_cb) Sigma_ab Ad(T_cb)' + Sigma_bc), so the part behind a pose follows
// by subtraction from what is remembered of the whole; nothing of single odometry edges is stored.

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"
#include "terse/core/at.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

}  // namespace

template <class Pose>
std::optional<UncertainPose<Pose>> Behind(const UncertainPose<Pose>& T_start_middle,
                                          const UncertainPose<Pose>& T_start_end) {
  using Jacobian = typename Pose::Jacobian;
  UncertainPose<Pose> out;
  out.T_a_b = T_start_middle.T_a_b.Inverse() * T_start_end.T_a_b;
  const Jacobian A = out.T_a_b.Inverse().Adjoint();
  const Jacobian before = A * T_start_middle.covariance * A.transpose();
  const Jacobian rest = T_start_end.covariance - before;
  out.covariance = (rest + rest.transpose()) / 2;
  // As seen by the whole: each direction keeps a share of its variance that is no rounding.
  const Eigen::LLT<Jacobian> whole(T_start_end.covariance);
  if (whole.info() != Eigen::Success) return std::nullopt;
  const Jacobian left = whole.matrixL().solve(out.covariance);
  const Jacobian share = whole.matrixL().solve(left.transpose());
  const Eigen::MatrixXd symmetric = (share + share.transpose()) / 2;
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> shares(symmetric, Eigen::EigenvaluesOnly);
  if (!(shares.eigenvalues()[0] > 1e-9)) return std::nullopt;
  return out;
}

// Whether a chain leads from a dropped pose to `newest`, in history_, and nothing else hangs on it: other odometry that
// starts from there hangs on the base too.
template <class Pose>
bool CompactPoseSlam<Pose>::IsPlainChain(PoseId dropped, int newest, int successors_of_newest) const {
  for (int k = newest; k >= 0 && !history_[At(k)].kept; k = history_[At(k)].parent) {
    if (history_[At(k)].successors > (k == newest ? successors_of_newest : 1)) return false;
    if (history_[At(k)].id == dropped) return true;
  }
  return false;
}

// Of a pose on the chain of the pose at hand.
template <class Pose>
typename CompactPoseSlam<Pose>::Revival CompactPoseSlam<Pose>::PlanRevivalOnChain(PoseId dropped,
                                                                                  const Current& current) const {
  const Seen& seen = Find(dropped);
  return {dropped, seen.base, seen.T_base_pose, {}, std::nullopt, {}, current.parent};
}

// Absent for a pose that is kept, whose chain has not ended at a kept pose, or cannot be split.
template <class Pose>
std::optional<typename CompactPoseSlam<Pose>::Revival> CompactPoseSlam<Pose>::PlanRevival(PoseId dropped) const {
  const Seen& seen = Find(dropped);
  if (seen.kept || !seen.next_kept || seen.ended_by >= 0) return std::nullopt;
  const auto behind = Behind(seen.T_base_pose, seen.T_base_next);
  const FactorId edge = Find(*seen.next_kept).odometry;
  const FactorNode<Pose>* node = solver_->Graph().FindFactor(edge);
  if (!behind || node == nullptr) return std::nullopt;
  const FactorPoses ends = PosesOf(node->factor);
  const bool joins = (ends.first == seen.base && ends.second == *seen.next_kept) ||
                     (ends.second == seen.base && ends.first == *seen.next_kept);
  const int newest = Find(*seen.next_kept).parent;
  if (!joins || !IsPlainChain(dropped, newest, 1)) return std::nullopt;
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

// After the update: `ids` of its first factors. Poses of the chain hang on the nearer of its parts.
template <class Pose>
void CompactPoseSlam<Pose>::Revive(const Revival& revival, const std::vector<FactorId>& ids) {
  const int at = index_.at(revival.pose.value);
  Seen& pose = history_[At(at)];
  std::vector<int> behind_it;
  if (revival.next) history_[At(index_.at(revival.next->value))].odometry = ids[1];
  ReviveEdges(revival, ids);
  for (int k = revival.newest; history_[At(k)].id != revival.pose; k = history_[At(k)].parent) {
    Seen& seen = history_[At(k)];
    const auto behind = Behind(revival.T_base_pose, seen.T_base_pose);
    const Pose T_pose_seen = revival.T_base_pose.T_a_b.Inverse() * seen.T_base_pose.T_a_b;
    seen.base = revival.pose;
    // Where only rounding is left, the two are one.
    seen.T_base_pose = behind.value_or(UncertainPose<Pose>{T_pose_seen});
    if (revival.next) seen.T_base_next = revival.T_pose_next;
    behind_it.push_back(k);
  }
  for (auto k = behind_it.rbegin(); k != behind_it.rend(); ++k) {
    Seen& seen = history_[At(*k)];
    if (seen.anchored) continue;
    const Seen& parent = history_[At(seen.parent)];
    seen.carried = seen.parent == at && history_[At(pose.stretch)].carried;
    seen.stretch = seen.parent == at ? *k : parent.stretch;
  }
  for (int k = pose.parent; !history_[At(k)].kept; k = history_[At(k)].parent) {
    Seen& seen = history_[At(k)];
    if (seen.next_kept != revival.next) continue;
    seen.next_kept = revival.pose;
    seen.T_base_next = revival.T_base_pose;
  }
  pose.kept = true;
  pose.base = revival.pose;
  pose.T_base_pose = {};
  pose.stretch = -1;
  pose.next_kept.reset();
  pose.T_base_next = {};
  pose.odometry = ids[0];
}

#define TERSE_INSTANTIATE(Pose)                                                                                     \
  template std::optional<UncertainPose<Pose>> Behind<Pose>(const UncertainPose<Pose>&, const UncertainPose<Pose>&); \
  template std::optional<CompactPoseSlam<Pose>::Revival> CompactPoseSlam<Pose>::PlanRevival(PoseId) const;          \
  template bool CompactPoseSlam<Pose>::IsPlainChain(PoseId, int, int) const;                                        \
  template CompactPoseSlam<Pose>::Revival CompactPoseSlam<Pose>::PlanRevivalOnChain(PoseId, const Current&) const;  \
  template void CompactPoseSlam<Pose>::AddRevival(const Revival&, GraphUpdate<Pose>&) const;                        \
  template void CompactPoseSlam<Pose>::ReviveEdges(const Revival&, const std::vector<FactorId>&);                   \
  template void CompactPoseSlam<Pose>::Revive(const Revival&, const std::vector<FactorId>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
