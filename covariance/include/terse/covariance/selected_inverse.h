#pragma once
// Diagonal blocks of H^-1 out of the factor, without forming H^-1.
//
// Recursion (Ila et al. 2017 Eqs. 9-13, on fronts): top-down, with K = L_SP L_PP^-1 and Sigma_SS taken from
// the parent's block,
//   Sigma_PP = L_PP^-T L_PP^-1 + K' Sigma_SS K,   Sigma_SP = -Sigma_SS K.
// A block is good as long as no front on its path to the root has changed since (Front::stamp): a query computes what
// is stale on the paths of the asked variables and keeps it for later ones. Few blocks after a change are cheaper by
// forward substitution, and many by one pass over everything; the choice is made by flops.
//
// Indices are variables of the factor and not checked. The factor must outlive the object. Concurrent queries are safe
// (serialised); changing the factor during a query is not.

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/covariance/covariance_options.h"

namespace terse {

namespace internal {
struct RecursionScratch;
}

template <int B>
class SelectedInverse {
 public:
  // Blocks of fronts that queries leave for later ones take at most so many bytes; the least recently used go first.
  explicit SelectedInverse(const BlockCholesky<B>& cholesky, std::size_t cache_bytes = std::size_t{256} << 20);
  ~SelectedInverse();

  // Sigma_vv.
  Matrix<B, B> Diagonal(int variable) const { return Diagonals({variable}).front(); }
  std::vector<Matrix<B, B>> Diagonals(const std::vector<int>& variables,
                                      DiagonalMethod method = DiagonalMethod::kCheapest) const;
  // All Sigma_vv, by variable, in one pass that keeps only one root path in memory.
  std::vector<Matrix<B, B>> AllDiagonals() const;

  std::size_t CacheBytes() const;

 private:
  struct Block {
    std::vector<double> covariance;  // of [P; S], n x n, column-major, full
    int n = 0;
    std::uint64_t stamp = 0;  // good for fronts that changed with this version at the latest
    std::uint64_t used = 0;
  };
  using BlockPointer = std::shared_ptr<Block>;
  // What a query has found out about a front.
  struct Known {
    std::uint64_t stamp = 0;  // of the last change from here to the root
    double solve_flops = 0;   // of substitution from here to the root
  };
  struct Query {
    std::unordered_map<int, Known> known;  // by front
    double recursion_flops = 0;            // of the blocks that are not good
  };
  const Known& Look(int front, Query& query) const;
  BlockPointer Front(int front, Query& query) const;
  void Evict() const;

  const BlockCholesky<B>* cholesky_;
  std::size_t capacity_;
  mutable std::mutex mutex_;
  mutable std::map<int, BlockPointer> cache_;
  mutable std::size_t bytes_ = 0;
  mutable std::unique_ptr<internal::RecursionScratch> scratch_;
  mutable std::uint64_t queries_ = 0, identity_ = 0;
};

extern template class SelectedInverse<3>;
extern template class SelectedInverse<6>;

}  // namespace terse
