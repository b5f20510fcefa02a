#include "terse/lie/so3.h"

#include <limits>

#include "terse/lie/coefficients.h"

namespace terse {

SO3 SO3::FromMatrix(const Matrix<3, 3>& R) { return SO3(Quaternion(R)); }

SO3 SO3::Exp(const Tangent& phi) {
  const double half = phi.norm() / 2;
  const double scale = internal::Quotient(1, half) / 2;
  return SO3(Quaternion(std::cos(half), scale * phi.x(), scale * phi.y(), scale * phi.z()));
}

SO3::Tangent SO3::Log() const {
  // q and -q are the same rotation; the one with w >= 0 has its angle in [0, pi].
  const double sign = q_.w() < 0 ? -1 : 1;
  const double w = sign * q_.w();
  const Tangent v = sign * q_.vec();
  const double n = v.norm();
  // atan(x)/x = 1 - x^2/3 + ... , exact to rounding here.
  if (n < 1e-5) return (2 / w) * (1 - n * n / (3 * w * w)) * v;
  return (2 * std::atan2(n, w) / n) * v;
}

namespace {

// a P + b P^2 with P = Hat(phi), on top of the identity: P^2 = phi phi' - phi' phi I.
Matrix<3, 3> Polynomial(const Vector<3>& phi, double a, double b) {
  const double x = phi.x(), y = phi.y(), z = phi.z();
  const double xx = b * x * x, yy = b * y * y, zz = b * z * z, xy = b * x * y, xz = b * x * z, yz = b * y * z;
  Matrix<3, 3> M;
  M << 1 - yy - zz, xy - a * z, xz + a * y, xy + a * z, 1 - xx - zz, yz - a * x, xz - a * y, yz + a * x, 1 - xx - yy;
  return M;
}

}  // namespace

SO3::Jacobian SO3::LeftJacobian(const Tangent& phi) {
  const double theta = phi.norm();
  return Polynomial(phi, internal::Quotient(2, theta), internal::Quotient(3, theta));
}

SO3::Jacobian SO3::LeftJacobianInverse(const Tangent& phi) {
  return Polynomial(phi, -0.5, internal::CotangentQuotient(phi.norm()));
}

void SO3::Normalize() {
  constexpr double kUnit = 4 * std::numeric_limits<double>::epsilon();
  double n2 = q_.squaredNorm();
  if (std::abs(n2 - 1) <= kUnit) return;
  // The squares of very large numbers overflow, those of very small ones vanish.
  const double largest = q_.coeffs().cwiseAbs().maxCoeff();
  if (largest > 1e100 || (largest > 0 && largest < 1e-100)) {
    q_.coeffs() /= largest;
    n2 = q_.squaredNorm();
  }
  if (std::abs(n2 - 1) > kUnit) q_.coeffs() /= std::sqrt(n2);
}

SO3::Jacobian SO3::RightJacobian(const Tangent& phi) { return LeftJacobian(-phi); }

SO3::Jacobian SO3::RightJacobianInverse(const Tangent& phi) { return LeftJacobianInverse(-phi); }

Matrix<3, 3> Hat(const Vector<3>& v) {
  Matrix<3, 3> V;
  V << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return V;
}

}  // namespace terse
