#pragma once
// SE(3): rigid motions in space. T_a_b maps coordinates of b into a: p_a = T_a_b * p_b.
//
// Tangent [rho; phi]: translation first, metres and radians. Exp is the full exponential, so
// translation = LeftJacobian_SO3(phi) rho. Perturbations are on the right: T Exp(d).
// Source of the 6x6 Jacobians: Barfoot, State Estimation for Robotics, Eqs. 7.85-7.95.

#include "terse/lie/so3.h"

namespace terse {

class SE3 {
 public:
  static constexpr int kDim = 3;  // of a position
  static constexpr int kDof = 6;
  using Position = Vector<3>;
  using Tangent = Vector<6>;
  using Jacobian = Matrix<6, 6>;

  SE3() : translation_(0, 0, 0) {}
  SE3(const SO3& rotation, const Position& translation) : rotation_(rotation), translation_(translation) {}

  static SE3 Exp(const Tangent& d);
  Tangent Log() const;

  SE3 operator*(const SE3& other) const {
    return SE3(rotation_ * other.rotation_, translation_ + rotation_ * other.translation_);
  }
  Position operator*(const Position& p) const { return rotation_ * p + translation_; }
  SE3 Inverse() const {
    const SO3 inverse = rotation_.Inverse();
    return SE3(inverse, -(inverse * translation_));
  }
  // Inverse() * other.
  SE3 Between(const SE3& other) const {
    const SO3 inverse = rotation_.Inverse();
    return SE3(inverse * other.rotation_, inverse * (other.translation_ - translation_));
  }
  // Exp(Adjoint() d) = T Exp(d) T^-1.
  Jacobian Adjoint() const;

  static Jacobian LeftJacobian(const Tangent& d);
  static Jacobian LeftJacobianInverse(const Tangent& d);
  static Jacobian RightJacobian(const Tangent& d);
  static Jacobian RightJacobianInverse(const Tangent& d);

  // The chart in which the optimiser moves a pose and measures a residual: T Exp(d), and its inverse.
  SE3 Retract(const Tangent& d) const { return *this * Exp(d); }
  Tangent Local(const SE3& other) const { return Between(other).Log(); }
  // d Local(E) / d e for E <- E Exp(e), at the residual r = E's chart coordinates.
  static Jacobian LocalJacobian(const Tangent& r) { return RightJacobianInverse(r); }

  const SO3& Rotation() const { return rotation_; }
  const Position& Translation() const { return translation_; }
  // Rotation angle in [0, pi] radians.
  double Angle() const;
  void Normalize() { rotation_.Normalize(); }

 private:
  SO3 rotation_;
  Position translation_;
};

}  // namespace terse
