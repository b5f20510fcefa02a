#include "terse/lie/so3.h"

#include <limits>

#include "terse/lie/coefficients.h"

namespace terse {

Matrix<3, 3> Hat(const Vector<3>& v) {
  Matrix<3, 3> V;
  V << 0, -v.z(), v.y(), v.z(), 0, -v.x(), -v.y(), v.x(), 0;
  return V;
}

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

Vector<3> SO3::operator*(const Vector<3>& p) const {
  const Vector<3> u = q_.vec();
  const Vector<3> t = 2 * u.cross(p);
  return p + q_.w() * t + u.cross(t);
}

SO3::Jacobian SO3::LeftJacobian(const Tangent& phi) {
  const double theta = phi.norm();
  const Matrix<3, 3> P = Hat(phi);
  return Jacobian::Identity() + internal::Quotient(2, theta) * P + internal::Quotient(3, theta) * P * P;
}

SO3::Jacobian SO3::LeftJacobianInverse(const Tangent& phi) {
  const Matrix<3, 3> P = Hat(phi);
  return Jacobian::Identity() - P / 2 + internal::CotangentQuotient(phi.norm()) * P * P;
}

void SO3::Normalize() {
  // The squares of very large numbers overflow, those of very small ones vanish.
  const double largest = q_.coeffs().cwiseAbs().maxCoeff();
  if (largest > 1e100 || (largest > 0 && largest < 1e-100)) q_.coeffs() /= largest;
  const double n2 = q_.squaredNorm();
  if (std::abs(n2 - 1) > 4 * std::numeric_limits<double>::epsilon()) q_.coeffs() /= std::sqrt(n2);
}

}  // namespace terse
