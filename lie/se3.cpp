#include "terse/lie/se3.h"

#include "terse/lie/coefficients.h"

namespace terse {
namespace {

// The upper right block of the left Jacobian (Barfoot, Eq. 7.86b).
Matrix<3, 3> TranslationBlock(const Vector<3>& rho, const Vector<3>& phi) {
  const double theta = phi.norm();
  const double c = internal::Quotient(3, theta);
  const double d = internal::Quotient(4, theta);
  const double e = internal::Quotient(5, theta);
  const Matrix<3, 3> R = Hat(rho), P = Hat(phi);
  const Matrix<3, 3> PR = P * R, RP = R * P, PRP = PR * P;
  return R / 2 + c * (PR + RP + PRP) + d * (P * PR + RP * P - 3 * PRP) + (d - 3 * e) / 2 * (PRP * P + P * PRP);
}

}  // namespace

SE3 SE3::Exp(const Tangent& d) {
  const Vector<3> phi = d.tail<3>();
  return SE3(SO3::Exp(phi), SO3::LeftJacobian(phi) * d.head<3>());
}

SE3::Tangent SE3::Log() const {
  const Vector<3> phi = rotation_.Log();
  Tangent d;
  d << SO3::LeftJacobianInverse(phi) * translation_, phi;
  return d;
}

SE3 SE3::Inverse() const {
  const SO3 inverse = rotation_.Inverse();
  return SE3(inverse, -(inverse * translation_));
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

}  // namespace terse
