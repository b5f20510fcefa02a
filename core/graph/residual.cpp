#include "terse/core/residual.h"

namespace terse {

template <class Pose>
RelativeResidual<Pose> EvaluateRelative(const Pose& T_from_to, const Pose& T_world_from, const Pose& T_world_to) {
  const Pose T_to_from = T_world_to.Between(T_world_from);
  RelativeResidual<Pose> out;
  out.residual = (T_world_from * T_from_to).Local(T_world_to);
  out.J_residual_to = Pose::LocalJacobian(out.residual);
  out.J_residual_from = -out.J_residual_to * T_to_from.Adjoint();
  return out;
}

template <class Pose>
PriorResidual<Pose> EvaluatePrior(const Pose& T_measured, const Pose& T_world_body) {
  PriorResidual<Pose> out;
  out.residual = T_measured.Local(T_world_body);
  out.J_residual_pose = Pose::LocalJacobian(out.residual);
  return out;
}

template <class Pose>
PositionResidual<Pose> EvaluatePosition(const PositionPriorFactor<Pose>& prior, const Pose& T_world_body) {
  PositionResidual<Pose> out;
  out.residual = T_world_body * prior.p_body - prior.p_world;
  // The point moves as the origin of T * (I, p_body) does, by the translation that the adjoint of (I, -p_body) gives:
  // d (t + R (rho + phi^ p_body)) / d [rho; phi].
  typename Pose::Tangent shift = Pose::Tangent::Zero();
  shift.template head<Pose::kDim>() = -prior.p_body;
  const typename Pose::Jacobian at_point = Pose().Retract(shift).Adjoint(), R = T_world_body.Adjoint();
  out.J_residual_pose = R.template topLeftCorner<Pose::kDim, Pose::kDim>() * at_point.template topRows<Pose::kDim>();
  return out;
}

namespace {

template <class Residual, class Information>
double Weighted(const Residual& r, const Information& information) {
  return r.dot(information * r);
}

}  // namespace

template <class Pose>
double FactorChi2(const Factor<Pose>& factor, const Pose& T_world_first, const Pose& T_world_second) {
  if (const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor)) {
    const typename Pose::Tangent r = (T_world_first * f->T_from_to).Local(T_world_second);
    return Weighted(r, f->information);
  }
  if (const auto* f = std::get_if<PosePriorFactor<Pose>>(&factor)) {
    const typename Pose::Tangent r = f->T_world_body.Local(T_world_first);
    return Weighted(r, f->information);
  }
  const auto& f = std::get<PositionPriorFactor<Pose>>(factor);
  const typename Pose::Position r = T_world_first * f.p_body - f.p_world;
  return Weighted(r, f.information);
}

#define TERSE_INSTANTIATE(Pose)                                                                          \
  template RelativeResidual<Pose> EvaluateRelative<Pose>(const Pose&, const Pose&, const Pose&);         \
  template PriorResidual<Pose> EvaluatePrior<Pose>(const Pose&, const Pose&);                            \
  template PositionResidual<Pose> EvaluatePosition<Pose>(const PositionPriorFactor<Pose>&, const Pose&); \
  template double FactorChi2<Pose>(const Factor<Pose>&, const Pose&, const Pose&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
