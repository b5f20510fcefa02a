#pragma once
// SE(2): rigid motions in the plane, stored as [x y theta], theta in (-pi, pi] radians, with its cosine and sine, which
// every use would compute again.
//
// Exp, Log, adjoint and Jacobians are those of the group, tangent [rho_x rho_y phi].
// The optimiser uses the chart of the 2D papers and files instead: Retract(d) = T * SE2(d[0], d[1], d[2]) and
// Local = the [x y theta] of T^-1 * other. Both charts have the same first derivative at zero, so the
// covariances are the same; the second makes a Gauss-Newton step equal to one in global x, y, theta.

#include <cmath>

#include "terse/lie/types.h"

namespace terse {

// The angle in (-pi, pi]; angles already there are returned unchanged.
double WrapAngle(double radians);

class SE2 {
 public:
  static constexpr int kDim = 2;  // of a position
  static constexpr int kDof = 3;
  using Position = Vector<2>;
  using Tangent = Vector<3>;
  using Jacobian = Matrix<3, 3>;

  SE2() = default;
  SE2(double x, double y, double theta) : SE2(Position(x, y), theta) {}
  SE2(const Position& translation, double theta)
      : translation_(translation), theta_(WrapAngle(theta)), cosine_(std::cos(theta_)), sine_(std::sin(theta_)) {}

  static SE2 Exp(const Tangent& d);
  Tangent Log() const;

  SE2 operator*(const SE2& other) const { return SE2(*this * other.translation_, theta_ + other.theta_); }
  Position operator*(const Position& p) const { return Moved(p.x(), p.y()); }
  // Inverse() * other.
  SE2 Between(const SE2& other) const { return SE2(InBody(other.translation_), other.theta_ - theta_); }
  SE2 Inverse() const { return SE2(InBody(Position(0, 0)), -theta_); }
  Jacobian Adjoint() const;

  static Jacobian LeftJacobian(const Tangent& d);
  static Jacobian LeftJacobianInverse(const Tangent& d);
  static Jacobian RightJacobian(const Tangent& d);
  static Jacobian RightJacobianInverse(const Tangent& d);

  SE2 Retract(const Tangent& d) const { return SE2(Moved(d[0], d[1]), theta_ + d[2]); }
  Tangent Local(const SE2& other) const {
    const Position p = InBody(other.translation_);
    return Tangent(p.x(), p.y(), WrapAngle(other.theta_ - theta_));
  }
  // d [x y theta](E) / d e for E <- E * SE2(e), at [x y theta](E) = r.
  static Jacobian LocalJacobian(const Tangent& r);

  Matrix<2, 2> Rotation() const {
    Matrix<2, 2> R;
    R(0, 0) = cosine_;
    R(0, 1) = -sine_;
    R(1, 0) = sine_;
    R(1, 1) = cosine_;
    return R;
  }
  const Position& Translation() const { return translation_; }
  double Theta() const { return theta_; }
  // |theta|, in [0, pi] radians.
  double Angle() const { return theta_ < 0 ? -theta_ : theta_; }
  void Normalize() {}  // the angle always is

 private:
  // By scalars: products of matrices would be instantiated anew in each source that includes this.
  Position Moved(double x, double y) const {
    return Position((cosine_ * x - sine_ * y) + translation_.x(), (sine_ * x + cosine_ * y) + translation_.y());
  }
  Position InBody(const Position& p) const {
    const double x = p.x() - translation_.x(), y = p.y() - translation_.y();
    return Position(cosine_ * x + sine_ * y, cosine_ * y - sine_ * x);
  }

  Position translation_{0, 0};
  double theta_ = 0, cosine_ = 1, sine_ = 0;
};

}  // namespace terse
