#include "terse/compact/uncertain_pose.h"

#include <stdexcept>

#include "terse/core/definite.h"

namespace terse {

namespace {

// E[(x1 x y1)(x2 x y2)'] for P = E[x1 x2'] and Q = E[y1 y2'], x's independent of y's.
Matrix<3, 3> CrossMoment(const Matrix<3, 3>& P, const Matrix<3, 3>& Q) {
  Matrix<3, 3> C;
  for (int a = 0; a < 3; ++a) {
    const int i = (a + 1) % 3, k = (a + 2) % 3;
    for (int b = 0; b < 3; ++b) {
      const int j = (b + 1) % 3, l = (b + 2) % 3;
      C(a, b) = P(i, j) * Q(k, l) - P(i, l) * Q(k, j) - P(k, j) * Q(i, l) + P(k, l) * Q(i, j);
    }
  }
  return C;
}

// E[ad(x) Y ad(x)'], ad(x) y = [phi_x x rho_y + rho_x x phi_y; phi_x x phi_y].
Matrix<6, 6> BracketMoment(const Matrix<6, 6>& X, const Matrix<6, 6>& Y) {
  const auto block = [](const Matrix<6, 6>& S, int row, int column) -> Matrix<3, 3> {
    return S.block<3, 3>(3 * row, 3 * column);
  };
  const Matrix<3, 3> mixed = CrossMoment(block(X, 1, 0), block(Y, 0, 1));
  const Matrix<3, 3> side = CrossMoment(block(X, 1, 1), block(Y, 0, 1)) + CrossMoment(block(X, 0, 1), block(Y, 1, 1));
  Matrix<6, 6> B;
  B << CrossMoment(block(X, 1, 1), block(Y, 0, 0)) + mixed + mixed.transpose() +
           CrossMoment(block(X, 0, 0), block(Y, 1, 1)),
      side, side.transpose(), CrossMoment(block(X, 1, 1), block(Y, 1, 1));
  return B;
}

// E[ad(x) ad(x)], with [a]_x [b]_x = b a' - a'b I.
Matrix<6, 6> SquaredBracketMean(const Matrix<6, 6>& X) {
  const Matrix<3, 3> I = Matrix<3, 3>::Identity(), X_rho_phi = X.topRightCorner<3, 3>(),
                     X_phi_phi = X.bottomRightCorner<3, 3>();
  const Matrix<3, 3> turn = X_phi_phi - X_phi_phi.trace() * I;
  Matrix<6, 6> A;
  A << turn, X_rho_phi + X_rho_phi.transpose() - 2 * X_rho_phi.trace() * I, Matrix<3, 3>::Zero(), turn;
  return A;
}

// A quarter turn on both sides, J M J'.
Matrix<2, 2> QuarterTurned(const Matrix<2, 2>& M) {
  Matrix<2, 2> out;
  out << M(1, 1), -M(1, 0), -M(0, 1), M(0, 0);
  return out;
}

// In the plane ad(x) y = [phi_x J rho_y - phi_y J rho_x; 0], J the quarter turn.
Matrix<3, 3> BracketMoment(const Matrix<3, 3>& X, const Matrix<3, 3>& Y) {
  const Matrix<2, 2> mixed = X.topRightCorner<2, 1>() * Y.topRightCorner<2, 1>().transpose();
  Matrix<3, 3> B = Matrix<3, 3>::Zero();
  B.topLeftCorner<2, 2>() =
      QuarterTurned(X(2, 2) * Y.topLeftCorner<2, 2>() + Y(2, 2) * X.topLeftCorner<2, 2>() - mixed - mixed.transpose());
  return B;
}

Matrix<3, 3> SquaredBracketMean(const Matrix<3, 3>& X) {
  Matrix<3, 3> A = Matrix<3, 3>::Zero();
  A.topLeftCorner<2, 2>().diagonal().setConstant(-X(2, 2));
  A.topRightCorner<2, 1>() = X.topRightCorner<2, 1>();
  return A;
}

template <class Jacobian>
Jacobian Symmetric(const Jacobian& M) {
  return (M + M.transpose()) / 2;
}

}  // namespace

template <class Pose>
UncertainPose<Pose> Compose(const UncertainPose<Pose>& ab, const UncertainPose<Pose>& bc, CompositionOrder order) {
  using Jacobian = typename Pose::Jacobian;
  const Jacobian A = bc.T_a_b.Inverse().Adjoint();
  const Jacobian X = A * ab.covariance * A.transpose();
  const Jacobian& Y = bc.covariance;
  Jacobian covariance;
  if (order == CompositionOrder::kFirst) {
    covariance = X + Y;
  } else {
    const Jacobian to_X = Jacobian::Identity() + SquaredBracketMean(Y) / 12,
                   to_Y = Jacobian::Identity() + SquaredBracketMean(X) / 12;
    covariance = to_X * X * to_X.transpose() + to_Y * Y * to_Y.transpose() + BracketMoment(X, Y) / 4;
  }
  return {ab.T_a_b * bc.T_a_b, Symmetric(covariance)};
}

template <>
Matrix<6, 6> RetractCovariance<SE3>(const UncertainPose<SE3>& ab) {
  return ab.covariance;
}

// The second moment of [(1 - phi^2/6) rho + phi/2 J rho; phi], V(phi) rho to third order.
template <>
Matrix<3, 3> RetractCovariance<SE2>(const UncertainPose<SE2>& ab) {
  const Matrix<2, 2> P = ab.covariance.topLeftCorner<2, 2>();
  const Vector<2> c = ab.covariance.topRightCorner<2, 1>();
  const double v = ab.covariance(2, 2);
  const Matrix<2, 2> cc = c * c.transpose(), M = v * P + 2 * cc;  // E[phi^2 rho rho']
  Matrix<3, 3> out = ab.covariance;
  out.topLeftCorner<2, 2>() += QuarterTurned(M) / 4 - M / 3 + (v / 12) * (v * P + 4 * cc);
  out.topRightCorner<2, 1>() -= v / 2 * c;
  out.bottomLeftCorner<1, 2>() = out.topRightCorner<2, 1>().transpose();
  return Symmetric(out);
}

template <class Pose>
UncertainPose<Pose> Invert(const UncertainPose<Pose>& ab) {
  const typename Pose::Jacobian A = ab.T_a_b.Adjoint();
  const typename Pose::Jacobian covariance = A * ab.covariance * A.transpose();
  return {ab.T_a_b.Inverse(), (covariance + covariance.transpose()) / 2};
}

template <class Pose>
UncertainPose<Pose> SeenFrom(PoseId first, const RelativePoseFactor<Pose>& factor) {
  const typename Pose::Jacobian covariance = InverseOfDefinite<Pose::kDof>(factor.information);
  UncertainPose<Pose> measured{factor.T_from_to, (covariance + covariance.transpose()) / 2};
  if (first == factor.from) return measured;
  if (first == factor.to) return Invert(measured);
  throw std::invalid_argument("the factor does not touch pose " + std::to_string(first.value));
}

#define TERSE_INSTANTIATE(Pose)                                                                      \
  template UncertainPose<Pose> Compose<Pose>(const UncertainPose<Pose>&, const UncertainPose<Pose>&, \
                                             CompositionOrder);                                      \
  template UncertainPose<Pose> Invert<Pose>(const UncertainPose<Pose>&);                             \
  template UncertainPose<Pose> SeenFrom<Pose>(PoseId, const RelativePoseFactor<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
