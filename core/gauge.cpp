#include "terse/core/gauge.h"

#include <set>

namespace terse {

template <class Pose>
AbsoluteFactors CountAbsoluteFactors(const PoseGraph<Pose>& graph) {
  AbsoluteFactors count;
  std::set<PoseId> positions;
  for (const auto& node : graph.Poses()) {
    if (node.fixed && node.T_world_body) ++count.pose_priors;
  }
  for (const auto& node : graph.Factors()) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(node.factor)) ++count.pose_priors;
    if (const auto* f = std::get_if<PositionPriorFactor<Pose>>(&node.factor)) positions.insert(f->pose);
  }
  count.position_prior_poses = static_cast<int>(positions.size());
  return count;
}

template <class Pose>
Vector<Pose::kDof> AnchorInformation(const AbsoluteFactors& absolute) {
  Vector<Pose::kDof> information = Vector<Pose::kDof>::Zero();
  if (absolute.pose_priors > 0 || absolute.position_prior_poses >= Pose::kDim) return information;
  information.setConstant(kAnchorInformation);
  if (absolute.position_prior_poses > 0) information.template head<Pose::kDim>().setZero();
  return information;
}

template <class Pose>
PosePriorFactor<Pose> FixedPosePrior(PoseId id, const Pose& T_world_body) {
  return {id, T_world_body, kAnchorInformation * Pose::Jacobian::Identity()};
}

#define TERSE_INSTANTIATE(Pose)                                                \
  template AbsoluteFactors CountAbsoluteFactors<Pose>(const PoseGraph<Pose>&); \
  template Vector<Pose::kDof> AnchorInformation<Pose>(const AbsoluteFactors&); \
  template PosePriorFactor<Pose> FixedPosePrior<Pose>(PoseId, const Pose&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
