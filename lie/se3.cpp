#include "terse/lie/se3.h"

#include "terse/lie/coefficients.h"

namespace terse {
namespace {

// The upper right block of the left Jacobian (Barfoot, Eq. 7.86b), with P = Hat(phi), R = Hat(rho), s = phi' rho and
// P R P = -s P, P R + R P = rho phi' + phi rho' - 2 s I, P P R + R P P = -theta^2 R - s P put in.
Matrix<3, 3> TranslationBlock(const Vector<3>& rho, const Vector<3>& phi) {
  const double t2 = phi.squaredNorm(), theta = std::sqrt(t2), s = phi.dot(rho);
  const double c = internal::Quotient(3, theta);
  const double d = internal::Quotient(4, theta);
  const double e = internal::Quotient(5, theta);
  const double square = s * (3 * e - d);
  const Vector<3> odd = (0.5 - d * t2) * rho + (s * (2 * d - c)) * phi;
  const Vector<3> half = c * rho + (square / 2) * phi;
  Matrix<3, 3> Q = phi * half.transpose();
  Q += Q.transpose().eval();
  Q.diagonal().array() -= 2 * c * s + square * t2;
  return Q + Hat(odd);
}

}  // namespace

SE3 SE3::Exp(const Tangent& d) {
  const Vector<3> rho = d.head<3>(), phi = d.tail<3>();
  const double theta = phi.norm();
  const Vector<3> turned = phi.cross(rho);
  return SE3(SO3::Exp(phi),
             rho + internal::Quotient(2, theta) * turned + internal::Quotient(3, theta) * phi.cross(turned));
}

SE3::Tangent SE3::Log() const {
  const Vector<3> phi = rotation_.Log(), turned = phi.cross(translation_);
  Tangent d;
  d << translation_ - turned / 2 + internal::CotangentQuotient(phi.norm()) * phi.cross(turned), phi;
  return d;
}

SE3::Jacobian SE3::Adjoint() const {
  const Matrix<3, 3> R = rotation_.Rotation();
  Jacobian A;
  A << R, Hat(translation_) * R, Matrix<3, 3>::Zero(), R;
  return A;
}

SE3::Jacobian SE3::LeftJacobian(const Tangent& d) {
  const Vector<3> rho = d.head<3>(), phi = d.tail<3>();
  const Matrix<3, 3> J = SO3::LeftJacobian(phi);
  Jacobian A;
  A << J, TranslationBlock(rho, phi), Matrix<3, 3>::Zero(), J;
  return A;
}

SE3::Jacobian SE3::LeftJacobianInverse(const Tangent& d) {
  const Vector<3> rho = d.head<3>(), phi = d.tail<3>();
  const Matrix<3, 3> J_inverse = SO3::LeftJacobianInverse(phi);
  Jacobian A;
  A << J_inverse, -J_inverse * TranslationBlock(rho, phi) * J_inverse, Matrix<3, 3>::Zero(), J_inverse;
  return A;
}

SE3::Jacobian SE3::RightJacobian(const Tangent& d) { return LeftJacobian(-d); }

SE3::Jacobian SE3::RightJacobianInverse(const Tangent& d) { return LeftJacobianInverse(-d); }

double SE3::Angle() const { return rotation_.Log().norm(); }

}  // namespace terse
