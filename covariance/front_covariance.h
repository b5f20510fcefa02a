#pragma once
// The covariance of one front's variables from that of its parent's: a step of the recursion (selected_inverse.h).

#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/core/front_paths.h"

namespace terse::internal {

// Buffers that stay allocated from front to front.
struct FrontScratch {
  std::vector<double> V, K, M, corner;  // K: K' of the last front, leading dimension Padded(p)
  std::vector<int> row_of;              // by variable
};

// Rows of P are filled up with zeros, so that the kernels have no odd ones.
constexpr int Padded(int rows) { return (rows + 7) / 8 * 8; }

// Where a front's separators are among the parent's [P; S], in scalars. scratch.row_of holds the parent's rows.
template <int B>
void SeparatorRows(const Front<B>& front, const FrontScratch& scratch, std::vector<int>& rows) {
  rows.clear();
  for (const int v : front.separators) rows.push_back(scratch.row_of[At(v)]);
}

// Enters the rows of a front's variables.
template <int B>
void SetRows(const Front<B>& front, int variables, FrontScratch& scratch) {
  scratch.row_of.resize(At(variables));
  front.ForEachRow([&](int v, int row) { scratch.row_of[At(v)] = row; });
}

// Sigma (n x n, n = p + s) of [P; S]. `parent` is the parent's, with leading dimension ldp; none for a root. If
// diagonal_only, only the diagonal blocks of the pivots are meaningful.
template <int B>
void ComputeFrontCovariance(const Front<B>& front, const double* parent, int ldp,
                            const std::vector<int>& rows_in_parent, bool diagonal_only, double* Sigma,
                            FrontScratch& scratch);

// Flops of ComputeFrontCovariance.
template <int B>
double RecursionFlops(const Front<B>& front) {
  const double p = front.Columns(), s = front.Rows() - 1 - p;
  return 2 * p * p * p / 3 + 2 * s * p * p + 2 * s * s * p;
}

template <int B>
double AllRecursionFlops(const BlockCholesky<B>& cholesky) {
  double flops = 0;
  cholesky.Tree().ForEach([&](int, const auto& front) { flops += RecursionFlops<B>(front); });
  return flops;
}

// A front on the way down from the root.
struct RecursionLevel {
  int front = -1, n = 0;
  std::vector<double> covariance;
  std::vector<std::vector<int>> rows;  // by child: its separators'
  std::size_t next_child = 0;
};

struct RecursionScratch {
  FrontScratch front;
  std::vector<RecursionLevel> path;
  std::vector<double> column;
};

// All Sigma_vv, by variable, in one pass that keeps one path in memory. If a column is asked for, also Sigma_.v of that
// variable: rows of Stride(B), those of variable i from B i on.
struct ColumnOfAll {
  int variable;
  std::vector<double>* X;
};
template <int B>
void ComputeAllDiagonals(const BlockCholesky<B>& cholesky, std::vector<Matrix<B, B>>& out, RecursionScratch& scratch,
                         const ColumnOfAll* column = nullptr);

}  // namespace terse::internal
