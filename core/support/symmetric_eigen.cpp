#include "support/symmetric_eigen.h"

#include <Eigen/Eigenvalues>

namespace terse {

SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& M) {
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(M);
  return {eigen.eigenvalues(), eigen.eigenvectors()};
}

}  // namespace terse
