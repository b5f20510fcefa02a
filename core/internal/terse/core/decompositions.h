#pragma once
// Decompositions of small matrices, compiled once for each size: Eigen's take seconds to compile.

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

// N: 3, 6 or Eigen::Dynamic. Of a matrix that has none it is not finite, or huge.
template <int N>
Eigen::Matrix<double, N, N> InverseOf(const Eigen::Matrix<double, N, N>& M);
// An estimate of 1 / (|M| |M^-1|), in the norm of the largest column sum.
template <int N>
double ReciprocalCondition(const Eigen::Matrix<double, N, N>& M);

// M = U diag(values) V^T, the values in descending order. D: 2 or 3.
template <int D>
struct SingularValues {
  using Square = Eigen::Matrix<double, D, D>;
  explicit SingularValues(const Square& M);
  // The orthogonal matrix R that maximises tr(R^T M), the closest to M in the Frobenius norm: the rotation, or with
  // sign -1 the reflection.
  Square ClosestOrthogonal(double sign = 1) const;

  Square U, V;
  Eigen::Matrix<double, D, 1> values;
};
extern template struct SingularValues<2>;
extern template struct SingularValues<3>;

template <int D>
Eigen::Matrix<double, D, D> ClosestRotation(const Eigen::Matrix<double, D, D>& M) {
  return SingularValues<D>(M).ClosestOrthogonal();
}

}  // namespace terse
