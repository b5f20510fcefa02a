#pragma once
// Residuals and exact Jacobians of the factors, at given pose values.
//
// Jacobians are with respect to a right perturbation T <- T.Retract(d), d = [rho; phi].

#include "terse/core/pose_graph.h"

namespace terse {

// r = Local(T_from_to^-1 * T_world_from^-1 * T_world_to).
SE2::Tangent RelativeError(const SE2& T_from_to, const SE2& T_world_from, const SE2& T_world_to);
SE3::Tangent RelativeError(const SE3& T_from_to, const SE3& T_world_from, const SE3& T_world_to);

// That, and J_r_from = -J_r_to * Ad(T_world_to^-1 T_world_from).
template <class Pose>
struct RelativeResidual {
  typename Pose::Tangent residual;
  typename Pose::Jacobian J_residual_from, J_residual_to;
};
template <class Pose>
RelativeResidual<Pose> EvaluateRelative(const Pose& T_from_to, const Pose& T_world_from, const Pose& T_world_to);

// r = Local(measured^-1 * T_world_body).
template <class Pose>
struct PriorResidual {
  typename Pose::Tangent residual;
  typename Pose::Jacobian J_residual_pose;
};
template <class Pose>
PriorResidual<Pose> EvaluatePrior(const Pose& T_measured, const Pose& T_world_body);

// r = T_world_body * p_body - p_world; J = R [I -p_body^].
template <class Pose>
struct PositionResidual {
  typename Pose::Position residual;
  Matrix<Pose::kDim, Pose::kDof> J_residual_pose;
};
template <class Pose>
PositionResidual<Pose> EvaluatePosition(const PositionPriorFactor<Pose>& prior, const Pose& T_world_body);

// r' Omega r of one factor. `to` is ignored by priors.
template <class Pose>
double FactorChi2(const Factor<Pose>& factor, const Pose& T_world_first, const Pose& T_world_second);

}  // namespace terse
