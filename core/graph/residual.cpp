#include "terse/core/residual.h"

namespace terse {
namespace {

// J Ad(T), J = [A B; 0 A] as LocalJacobian gives it and Ad(T) = [R t^R; 0 R].
Matrix<6, 6> TimesAdjoint(const Matrix<6, 6>& J, const SE3& T) {
  const Matrix<3, 3> R = T.Rotation().Rotation(), A = J.topLeftCorner<3, 3>();
  const Matrix<3, 3> AR = A * R, shifted = A * Hat(T.Translation()) + J.topRightCorner<3, 3>();
  Matrix<6, 6> out;
  out.topLeftCorner<3, 3>() = out.bottomRightCorner<3, 3>() = AR;
  out.topRightCorner<3, 3>().noalias() = shifted * R;
  out.bottomLeftCorner<3, 3>().setZero();
  return out;
}

}  // namespace

SE3::Tangent RelativeError(const SE3& T_from_to, const SE3& T_world_from, const SE3& T_world_to) {
  return (T_world_from * T_from_to).Local(T_world_to);
}

// With the rotations that the poses hold: no angle needs its sine.
SE2::Tangent RelativeError(const SE2& T_from_to, const SE2& T_world_from, const SE2& T_world_to) {
  const Vector<2> p = T_world_from.Rotation().transpose() * (T_world_to.Translation() - T_world_from.Translation());
  const Vector<2> e = T_from_to.Rotation().transpose() * (p - T_from_to.Translation());
  return {e.x(), e.y(), WrapAngle(T_world_to.Theta() - T_world_from.Theta() - T_from_to.Theta())};
}

template <>
RelativeResidual<SE3> EvaluateRelative(const SE3& T_from_to, const SE3& T_world_from, const SE3& T_world_to) {
  const SE3 T_to_from = T_world_to.Between(T_world_from);
  RelativeResidual<SE3> out;
  out.residual = RelativeError(T_from_to, T_world_from, T_world_to);
  out.J_residual_to = SE3::LocalJacobian(out.residual);
  out.J_residual_from = -TimesAdjoint(out.J_residual_to, T_to_from);
  return out;
}

template <>
RelativeResidual<SE2> EvaluateRelative(const SE2& T_from_to, const SE2& T_world_from, const SE2& T_world_to) {
  const Matrix<2, 2> R_measured_from = T_from_to.Rotation().transpose();
  const Matrix<2, 2> R_measured_world = R_measured_from * T_world_from.Rotation().transpose();
  const Vector<2> arm = R_measured_world * (T_world_from.Translation() - T_world_to.Translation());
  RelativeResidual<SE2> out;
  out.residual = RelativeError(T_from_to, T_world_from, T_world_to);
  out.J_residual_to.setIdentity();
  out.J_residual_to.topLeftCorner<2, 2>().noalias() = R_measured_world * T_world_to.Rotation();
  out.J_residual_from.setIdentity();
  out.J_residual_from *= -1;
  out.J_residual_from.topLeftCorner<2, 2>() = -R_measured_from;
  out.J_residual_from.topRightCorner<2, 1>() << -arm.y(), arm.x();
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
    const typename Pose::Tangent r = RelativeError(f->T_from_to, T_world_first, T_world_second);
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
  template PriorResidual<Pose> EvaluatePrior<Pose>(const Pose&, const Pose&);                            \
  template PositionResidual<Pose> EvaluatePosition<Pose>(const PositionPriorFactor<Pose>&, const Pose&); \
  template double FactorChi2<Pose>(const Factor<Pose>&, const Pose&, const Pose&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
