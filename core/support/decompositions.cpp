#include "terse/core/decompositions.h"

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <limits>

namespace terse {

template <int N>
SymmetricEigen<N> DecomposeSymmetric(const Eigen::Matrix<double, N, N>& M) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, N, N>> eigen(M);
  return {eigen.eigenvalues(), eigen.eigenvectors()};
}

template <int N>
Eigen::Matrix<double, N, 1> SymmetricEigenvalues(const Eigen::Matrix<double, N, N>& M) {
  return Eigen::SelfAdjointEigenSolver<Eigen::Matrix<double, N, N>>(M, Eigen::EigenvaluesOnly).eigenvalues();
}

template <int N>
Eigen::Matrix<double, N, N> InverseOf(const Eigen::Matrix<double, N, N>& M) {
  return M.inverse();
}

template <int N>
double ReciprocalCondition(const Eigen::Matrix<double, N, N>& M) {
  return M.partialPivLu().rcond();
}

template <int D>
SingularValues<D>::SingularValues(const Square& M) {
  const Eigen::JacobiSVD<Square> svd(M, Eigen::ComputeFullU | Eigen::ComputeFullV);
  if (svd.info() != Eigen::Success) {  // not a number
    U = V = Square::Constant(std::numeric_limits<double>::quiet_NaN());
    values = U.col(0);
    return;
  }
  U = svd.matrixU();
  V = svd.matrixV();
  values = svd.singularValues();
}

template <int D>
Eigen::Matrix<double, D, D> SingularValues<D>::ClosestOrthogonal(double sign) const {
  Square turned = U;
  if (sign * (U * V.transpose()).determinant() < 0) turned.col(D - 1) *= -1;
  return turned * V.transpose();
}

template SymmetricEigen<1> DecomposeSymmetric<1>(const Eigen::Matrix<double, 1, 1>&);
template SymmetricEigen<2> DecomposeSymmetric<2>(const Eigen::Matrix<double, 2, 2>&);
template SymmetricEigen<3> DecomposeSymmetric<3>(const Eigen::Matrix<double, 3, 3>&);
template SymmetricEigen<6> DecomposeSymmetric<6>(const Eigen::Matrix<double, 6, 6>&);
template SymmetricEigen<Eigen::Dynamic> DecomposeSymmetric<Eigen::Dynamic>(const Eigen::MatrixXd&);
template Eigen::Matrix<double, 2, 1> SymmetricEigenvalues<2>(const Eigen::Matrix<double, 2, 2>&);
template Eigen::Matrix<double, 3, 1> SymmetricEigenvalues<3>(const Eigen::Matrix<double, 3, 3>&);
template Eigen::Matrix<double, 6, 1> SymmetricEigenvalues<6>(const Eigen::Matrix<double, 6, 6>&);
template Eigen::VectorXd SymmetricEigenvalues<Eigen::Dynamic>(const Eigen::MatrixXd&);
template Eigen::Matrix<double, 3, 3> InverseOf<3>(const Eigen::Matrix<double, 3, 3>&);
template Eigen::Matrix<double, 6, 6> InverseOf<6>(const Eigen::Matrix<double, 6, 6>&);
template Eigen::MatrixXd InverseOf<Eigen::Dynamic>(const Eigen::MatrixXd&);
template double ReciprocalCondition<3>(const Eigen::Matrix<double, 3, 3>&);
template double ReciprocalCondition<6>(const Eigen::Matrix<double, 6, 6>&);
template double ReciprocalCondition<Eigen::Dynamic>(const Eigen::MatrixXd&);
template struct SingularValues<2>;
template struct SingularValues<3>;

}  // namespace terse
