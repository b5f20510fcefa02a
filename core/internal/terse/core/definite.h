#pragma once
// Symmetric positive definite matrices, by Cholesky, compiled once for each size: Eigen's takes seconds to compile. N:
// 1, 2, 3 or 6. Only the lower triangle of a matrix is read. NaN passes for definite; of what is not, the others say
// nothing.

#include <Eigen/Core>

namespace terse {

template <int N>
bool IsDefinite(const Eigen::Matrix<double, N, N>& M);
// L of M = L L^T, zeros above its diagonal.
template <int N>
Eigen::Matrix<double, N, N> LowerCholesky(const Eigen::Matrix<double, N, N>& M);
template <int N>
Eigen::Matrix<double, N, N> InverseOfDefinite(const Eigen::Matrix<double, N, N>& M);
// M^-1 b.
template <int N>
Eigen::Matrix<double, N, 1> SolveDefinite(const Eigen::Matrix<double, N, N>& M, const Eigen::Matrix<double, N, 1>& b);
// error^T covariance^-1 error; infinity if the covariance is not definite.
template <int N>
double MahalanobisSquared(const Eigen::Matrix<double, N, N>& covariance, const Eigen::Matrix<double, N, 1>& error);

}  // namespace terse
