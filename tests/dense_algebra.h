#pragma once
// Dense linear algebra for oracles. Eigen's decompositions are slow to compile: here they are compiled once.
// What needs a positive definite matrix throws std::runtime_error if it gets another.

#include <Eigen/Core>

namespace terse::testing {

Eigen::MatrixXd CholeskyFactor(const Eigen::MatrixXd& H);  // lower triangular L, H = L L'
Eigen::MatrixXd Solve(const Eigen::MatrixXd& H, const Eigen::MatrixXd& B);
double LogDeterminant(const Eigen::MatrixXd& H);
// By Cholesky factorisation in extended precision.
Eigen::MatrixXd Inverse(const Eigen::MatrixXd& H);
bool IsPositiveDefinite(const Eigen::MatrixXd& S);
// Ascending. S is symmetric, or the ones of A x = lambda B x with B positive definite.
Eigen::VectorXd Eigenvalues(const Eigen::MatrixXd& S);
Eigen::VectorXd Eigenvalues(const Eigen::MatrixXd& A, const Eigen::MatrixXd& B);

}  // namespace terse::testing
