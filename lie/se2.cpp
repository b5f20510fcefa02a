#include "terse/lie/se2.h"

#include <cmath>

#include "terse/lie/coefficients.h"

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;

// V with translation = V rho, and its derivative's quotients.
Matrix<2, 2> V(double theta) {
  const double a = internal::Quotient(1, theta), b = theta * internal::Quotient(2, theta);
  Matrix<2, 2> M;
  M << a, -b, b, a;
  return M;
}

}  // namespace

double WrapAngle(double radians) {
  if (radians > -kPi && radians <= kPi) return radians;
  const double wrapped = std::remainder(radians, 2 * kPi);
  return wrapped <= -kPi ? kPi : wrapped;
}

SE2 SE2::Exp(const Tangent& d) { return SE2(V(d[2]) * d.head<2>(), d[2]); }

SE2::Tangent SE2::Log() const {
  // V^-1 = [h t/2; -t/2 h] with h = (t/2) cot(t/2).
  const double h = 1 - theta_ * theta_ * internal::CotangentQuotient(theta_);
  Matrix<2, 2> V_inverse;
  V_inverse << h, theta_ / 2, -theta_ / 2, h;
  const Position rho = V_inverse * translation_;
  return Tangent(rho.x(), rho.y(), theta_);
}

SE2::Jacobian SE2::Adjoint() const {
  Jacobian A = Jacobian::Identity();
  A.topLeftCorner<2, 2>() = Rotation();
  A(0, 2) = translation_.y();
  A(1, 2) = -translation_.x();
  return A;
}

SE2::Jacobian SE2::LeftJacobian(const Tangent& d) {
  const double b = internal::Quotient(2, d[2]), c = d[2] * internal::Quotient(3, d[2]);
  Jacobian J = Jacobian::Identity();
  J.topLeftCorner<2, 2>() = V(d[2]);
  J(0, 2) = c * d[0] + b * d[1];
  J(1, 2) = c * d[1] - b * d[0];
  return J;
}

SE2::Jacobian SE2::LeftJacobianInverse(const Tangent& d) {
  const Jacobian J = LeftJacobian(d);
  const double h = 1 - d[2] * d[2] * internal::CotangentQuotient(d[2]);
  Jacobian I = Jacobian::Identity();
  I.topLeftCorner<2, 2>() << h, d[2] / 2, -d[2] / 2, h;
  I.topRightCorner<2, 1>() = -(I.topLeftCorner<2, 2>() * J.topRightCorner<2, 1>());
  return I;
}

SE2::Jacobian SE2::LocalJacobian(const Tangent& r) {
  Jacobian J = Jacobian::Identity();
  J.topLeftCorner<2, 2>() = SE2(0, 0, r[2]).Rotation();
  return J;
}

SE2::Jacobian SE2::RightJacobian(const Tangent& d) { return LeftJacobian(-d); }

SE2::Jacobian SE2::RightJacobianInverse(const Tangent& d) { return LeftJacobianInverse(-d); }

}  // namespace terse
