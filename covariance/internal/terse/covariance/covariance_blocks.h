#pragma once
// Single blocks of H^-1 by triangular solves with the factor, along the paths of the asked variables to the root.
// Variables are those of the factor, in any order, and not checked.

#include <vector>

#include "terse/core/block_cholesky.h"

namespace terse {

// Sigma(rows, columns): (B |rows|) x (B |columns|). Forward along the columns' paths, backward along everybody's.
template <int B>
MatrixX CovarianceBlocks(const BlockCholesky<B>& cholesky, const std::vector<int>& rows,
                         const std::vector<int>& columns);

// Sigma(variables, variables) = Z' Z, Z = L^-1 E: forward along the paths only.
template <int B>
MatrixX JointCovariance(const BlockCholesky<B>& cholesky, const std::vector<int>& variables);

template <int B>
struct CovarianceTerm {
  int variable;
  Matrix<B, B> A;
};

// Covariance of the sum of A d over the terms, d the variables' perturbations. Z' Z as well: nothing cancels, however
// small it is beside the covariances of the variables.
template <int B>
Matrix<B, B> CombinationCovariance(const BlockCholesky<B>& cholesky, const std::vector<CovarianceTerm<B>>& terms);

}  // namespace terse
