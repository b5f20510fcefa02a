#include "terse/core/gauge.h"

namespace terse {

template <class Pose>
AbsoluteFactors CountAbsoluteFactors(const PoseGraph<Pose>& graph) {
  AbsoluteFactors count;
  for (const auto& node : graph.Poses()) {
    if (node.fixed && node.T_world_body) ++count.pose_priors;
  }
  for (const auto& node : graph.Factors()) {
    if (std::holds_alternative<PosePriorFactor<Pose>>(node.factor)) ++count.pose_priors;
    if (std::holds_alternative<PositionPriorFactor<Pose>>(node.factor)) ++count.position_priors;
  }
  return count;
}

template <class Pose>
Vector<Pose::kDof> AnchorInformation(const AbsoluteFactors& absolute) {
  Vector<Pose::kDof> information = Vector<Pose::kDof>::Zero();
  if (absolute.pose_priors > 0) return information;
  if (absolute.position_priors == 0) return information.setConstant(kAnchorInformation);
  information.template tail<Pose::kDof - Pose::kDim>().setConstant(kWeakAnchorInformation);
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
