#pragma once
// SO(3): rotations in space, stored as a unit quaternion.
//
// Tangent phi is a rotation vector in radians; Exp(phi) rotates by |phi| about phi / |phi|.
// LeftJacobian J_l: Exp(phi + d) = Exp(J_l d) Exp(phi) to first order; RightJacobian(phi) = J_l(-phi).
// All functions are accurate to about 1e-14 from zero angle to pi. Thread-safe (pure values).

#include "terse/lie/types.h"

namespace terse {

class SO3 {
 public:
  static constexpr int kDof = 3;
  using Tangent = Vector<3>;
  using Jacobian = Matrix<3, 3>;

  SO3() : q_(1, 0, 0, 0) {}
  // q need not be unit: it is normalised unless it already is to the last bit.
  explicit SO3(const Quaternion& q) : q_(q) { Normalize(); }
  static SO3 FromMatrix(const Matrix<3, 3>& R);

  static SO3 Exp(const Tangent& phi);
  // |Log()| is in [0, pi].
  Tangent Log() const;

  SO3 operator*(const SO3& other) const { return SO3(q_ * other.q_); }
  Vector<3> operator*(const Vector<3>& p) const {
    // By scalars: expressions would be instantiated anew in each source that includes this.
    const double x = 2 * (q_.y() * p.z() - q_.z() * p.y()), y = 2 * (q_.z() * p.x() - q_.x() * p.z()),
                 z = 2 * (q_.x() * p.y() - q_.y() * p.x());
    return Vector<3>(p.x() + q_.w() * x + (q_.y() * z - q_.z() * y), p.y() + q_.w() * y + (q_.z() * x - q_.x() * z),
                     p.z() + q_.w() * z + (q_.x() * y - q_.y() * x));
  }
  SO3 Inverse() const { return SO3(q_.conjugate()); }
  Matrix<3, 3> Rotation() const { return q_.toRotationMatrix(); }
  Jacobian Adjoint() const { return Rotation(); }

  static Jacobian LeftJacobian(const Tangent& phi);
  static Jacobian LeftJacobianInverse(const Tangent& phi);
  static Jacobian RightJacobian(const Tangent& phi);
  static Jacobian RightJacobianInverse(const Tangent& phi);

  const Quaternion& Unit() const { return q_; }
  // Restores |q| = 1. Idempotent: a quaternion that is unit to rounding is left as it is.
  void Normalize();

 private:
  Quaternion q_;
};

// [v]_x, so that Hat(v) w = v x w.
Matrix<3, 3> Hat(const Vector<3>& v);

}  // namespace terse
