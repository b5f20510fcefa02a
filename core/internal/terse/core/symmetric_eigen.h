#pragma once
// Eigenvalues of symmetric matrices, compiled once for each size: Eigen's solver takes seconds to compile.

#include <Eigen/Core>

namespace terse {

// M = vectors diag(values) vectors^T, the values in ascending order.
template <int N>
struct SymmetricEigen {
  Eigen::Matrix<double, N, 1> values;
  Eigen::Matrix<double, N, N> vectors;
};
// N: 1, 2, 3, 6 or Eigen::Dynamic. Only the lower triangle of M is read.
template <int N>
SymmetricEigen<N> DecomposeSymmetric(const Eigen::Matrix<double, N, N>& M);
template <int N>
Eigen::Matrix<double, N, 1> SymmetricEigenvalues(const Eigen::Matrix<double, N, N>& M);

}  // namespace terse
