#pragma once
// Blocks of H^-1 out of the factor, without forming H^-1.
//
// Recursion (Ila et al., IJRR 2017, Eqs. 9-13, on fronts): top-down, with K = L_SP L_PP^-1 and Sigma_SS taken from
// the parent's block,
//   Sigma_PP = L_PP^-T L_PP^-1 + K' Sigma_SS K,   Sigma_SP = -Sigma_SS K.
// A query computes the fronts on its path to the root only and keeps them until the factor changes.
//
// Indices are variables of the factor and not checked. The factor must outlive the object. Concurrent queries are safe
// (serialised); changing the factor during a query is not.

#include <map>
#include <mutex>
#include <vector>

#include "terse/core/block_cholesky.h"

namespace terse {

template <int B>
class SelectedInverse {
 public:
  explicit SelectedInverse(const BlockCholesky<B>& factor) : factor_(&factor) {}

  // Sigma_vv.
  Matrix<B, B> Diagonal(int variable) const { return Diagonals({variable}).front(); }
  std::vector<Matrix<B, B>> Diagonals(const std::vector<int>& variables) const;
  // All Sigma_vv, by variable, in one pass that keeps only one root path in memory.
  std::vector<Matrix<B, B>> AllDiagonals() const;

 private:
  struct Block {
    std::vector<double> covariance;  // of [P; S], n x n, column-major, full
    int n = 0;
  };
  Block ComputeFront(int front, const Block* parent) const;
  const Block& Front(int front) const;

  const BlockCholesky<B>* factor_;
  mutable std::mutex mutex_;
  mutable std::map<int, Block> cache_;
  mutable std::uint64_t version_ = 0;
};

extern template class SelectedInverse<3>;
extern template class SelectedInverse<6>;

}  // namespace terse
