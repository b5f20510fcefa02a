#pragma once
// Eigenvalues of symmetric matrices of any size, compiled once: Eigen's solver takes seconds to compile for each fixed
// size. For paths that are rarely taken; it allocates.

#include <Eigen/Core>

namespace terse {

// M = vectors diag(values) vectors^T, the values in ascending order. Only the lower triangle of M is read.
struct SymmetricEigen {
  Eigen::VectorXd values;
  Eigen::MatrixXd vectors;
};
SymmetricEigen DecomposeSymmetric(const Eigen::MatrixXd& M);

}  // namespace terse
