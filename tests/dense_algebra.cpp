#include "dense_algebra.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <stdexcept>

namespace terse::testing {
namespace {

template <class Scalar>
auto Factor(const Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>& H) {
  Eigen::LLT<Eigen::Matrix<Scalar, Eigen::Dynamic, Eigen::Dynamic>> llt(H);
  if (llt.info() != Eigen::Success) throw std::runtime_error("the matrix is not positive definite");
  return llt;
}

}  // namespace

Eigen::MatrixXd CholeskyFactor(const Eigen::MatrixXd& H) { return Factor<double>(H).matrixL(); }

Eigen::MatrixXd Solve(const Eigen::MatrixXd& H, const Eigen::MatrixXd& B) { return Factor<double>(H).solve(B); }

double LogDeterminant(const Eigen::MatrixXd& H) { return 2 * CholeskyFactor(H).diagonal().array().log().sum(); }

Eigen::MatrixXd Inverse(const Eigen::MatrixXd& H) {
  using Long = Eigen::Matrix<long double, Eigen::Dynamic, Eigen::Dynamic>;
  const Long inverse = Factor<long double>(H.cast<long double>()).solve(Long::Identity(H.rows(), H.cols()));
  return inverse.cast<double>();
}

bool IsPositiveDefinite(const Eigen::MatrixXd& S) { return S.llt().info() == Eigen::Success; }

Eigen::VectorXd Eigenvalues(const Eigen::MatrixXd& S) {
  return Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(S, Eigen::EigenvaluesOnly).eigenvalues();
}

Eigen::VectorXd Eigenvalues(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B) {
  return Eigen::GeneralizedSelfAdjointEigenSolver<Eigen::MatrixXd>(A, B, Eigen::EigenvaluesOnly).eigenvalues();
}

}  // namespace terse::testing
