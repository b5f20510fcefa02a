#pragma once
// Triangular solves with several right-hand sides on the fronts of a factor. X is row-major with `stride` columns; a
// variable's rows start at row_of[variable].

#include <algorithm>
#include <limits>
#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/core/dense_kernels.h"

namespace terse::internal {

constexpr std::size_t At(int i) { return static_cast<std::size_t>(i); }

// The fronts from some variables up to their roots, parents before children.
template <int B>
class FactorPaths {
 public:
  explicit FactorPaths(const BlockCholesky<B>& factor) : factor_(&factor) {}
  ~FactorPaths() {
    for (const int f : fronts_) Position(f) = -1;
  }
  FactorPaths(const FactorPaths&) = delete;
  FactorPaths& operator=(const FactorPaths&) = delete;

  void Add(int variable) {
    const std::size_t begin = fronts_.size();
    for (int f = factor_->FrontOf(variable); f >= 0 && Position(f) < 0; f = factor_->FrontAt(f).parent) {
      fronts_.push_back(f);
      Position(f) = 0;
    }
    std::reverse(fronts_.begin() + static_cast<long>(begin), fronts_.end());
    for (std::size_t k = begin; k < fronts_.size(); ++k) Position(fronts_[k]) = static_cast<int>(k);
  }
  int Size() const { return static_cast<int>(fronts_.size()); }
  const typename BlockCholesky<B>::Front& operator[](int k) const { return factor_->FrontAt(fronts_[At(k)]); }
  // Where a front, the front of a variable, or the parent of a front, is in the list; -1: it is not.
  int Find(int front) const { return Position(front); }
  int PositionOf(int variable) const { return Position(factor_->FrontOf(variable)); }
  int ParentOf(int k) const {
    const int parent = (*this)[k].parent;
    return parent < 0 ? -1 : Position(parent);
  }

 private:
  // By front, -1 between uses; one list at a time in each thread.
  static int& Position(int front) {
    thread_local std::vector<int> positions;
    if (positions.size() <= At(front)) positions.resize(At(front) + 1, -1);
    return positions[At(front)];
  }
  const BlockCholesky<B>* factor_;
  std::vector<int> fronts_;
};

// All fronts, parents before children: visit(id, front).
template <int B, class Visit>
void ForEachFront(const BlockCholesky<B>& factor, const Visit& visit) {
  std::vector<int> stack(factor.Roots());
  while (!stack.empty()) {
    const int id = stack.back();
    stack.pop_back();
    const auto& front = factor.FrontAt(id);
    visit(id, front);
    stack.insert(stack.end(), front.children.begin(), front.children.end());
  }
}

// Scalars before a variable's in its front.
template <int B>
int PivotRow(const typename BlockCholesky<B>::Front& front, int variable) {
  return B * static_cast<int>(std::find(front.pivots.begin(), front.pivots.end(), variable) - front.pivots.begin());
}

template <int B>
void GatherRows(const std::vector<int>& variables, const std::vector<int>& row_of, const double* X, int stride,
                double* out) {
  for (const int v : variables) {
    const double* from = X + At(row_of[At(v)]) * At(stride);
    for (int k = 0; k < B * stride; k += B * kLanes, out += B * kLanes) {
      for (int i = 0; i < B * kLanes; ++i) out[i] = from[k + i];
    }
  }
}

template <int B>
void ScatterRows(const std::vector<int>& variables, const std::vector<int>& row_of, const double* in, int stride,
                 double* X) {
  for (const int v : variables) {
    double* to = X + At(row_of[At(v)]) * At(stride);
    for (int k = 0; k < B * stride; k += B * kLanes, in += B * kLanes) {
      for (int i = 0; i < B * kLanes; ++i) to[k + i] = in[i];
    }
  }
}

// X_P = L_PP^-1 X_P, X_S -= L_SP X_P, where X is zero before row `first` of the front.
template <int B>
void ForwardFront(const typename BlockCholesky<B>::Front& front, int first, const std::vector<int>& row_of, double* X,
                  int stride, std::vector<double>& scratch) {
  const int ld = front.Rows(), rows = ld - 1, p = front.Columns();
  scratch.resize(At(rows) * At(stride));
  GatherRows<B>(front.pivots, row_of, X, stride, scratch.data());
  GatherRows<B>(front.separators, row_of, X, stride, scratch.data() + At(p) * At(stride));
  Kernels().substitute_forward(front.panel.data() + At(first) * At(ld) + At(first), ld, rows - first, p - first,
                               scratch.data() + At(first) * At(stride), stride);
  ScatterRows<B>(front.pivots, row_of, scratch.data(), stride, X);
  ScatterRows<B>(front.separators, row_of, scratch.data() + At(p) * At(stride), stride, X);
}

// X_P = L_PP^-T (X_P - L_SP' X_S) from row `first` of the front on. If is_zero, X_P is taken for zero.
template <int B>
void BackwardFront(const typename BlockCholesky<B>::Front& front, int first, bool is_zero,
                   const std::vector<int>& row_of, double* X, int stride, std::vector<double>& scratch) {
  const int ld = front.Rows(), rows = ld - 1, p = front.Columns();
  scratch.resize(At(rows) * At(stride));
  if (is_zero) {
    std::fill_n(scratch.begin(), At(p) * At(stride), 0.0);
  } else {
    GatherRows<B>(front.pivots, row_of, X, stride, scratch.data());
  }
  GatherRows<B>(front.separators, row_of, X, stride, scratch.data() + At(p) * At(stride));
  Kernels().substitute_backward(front.panel.data() + At(first) * At(ld) + At(first), ld, rows - first, p - first,
                                scratch.data() + At(first) * At(stride), stride);
  ScatterRows<B>(front.pivots, row_of, scratch.data(), stride, X);
}

// Forward along the paths. first[k]: the first row of front k at which X is not zero, kNoRow if it is; lower(first, v)
// says that it is not zero at v.
inline constexpr int kNoRow = std::numeric_limits<int>::max();
template <int B, class Lower>
void ForwardPaths(const FactorPaths<B>& paths, std::vector<int>& first, const Lower& lower,
                  const std::vector<int>& row_of, double* X, int stride, std::vector<double>& scratch) {
  for (int k = paths.Size() - 1; k >= 0; --k) {
    if (first[At(k)] == kNoRow) continue;
    ForwardFront<B>(paths[k], first[At(k)], row_of, X, stride, scratch);
    for (const int v : paths[k].separators) lower(first, v);
  }
}

// A block of right-hand sides.
template <int B>
struct RightHandSide {
  int variable, column;
  Matrix<B, B> block;
};

template <int B>
void AddRightHandSide(const RightHandSide<B>& e, const std::vector<int>& row_of, double* X, int stride) {
  Eigen::Map<Eigen::Matrix<double, B, B, Eigen::RowMajor>, 0, Eigen::OuterStride<>>(
      X + At(row_of[At(e.variable)]) * At(stride) + At(e.column), Eigen::OuterStride<>(stride)) += e.block;
}

// X = H^-1 E for the pivots of the paths of E's variables: E is the sum of the blocks, X has the rows of variable v
// from B v on. What was in X before does not matter, if it is finite. All must be among the paths.
template <int B>
void SolvePaths(const FactorPaths<B>& paths, const std::vector<RightHandSide<B>>& E, int variables,
                std::vector<double>& X, int stride);

// The same for all variables.
template <int B>
void SolveAll(const BlockCholesky<B>& factor, const std::vector<RightHandSide<B>>& E, std::vector<double>& X,
              int stride);

// By variable, one use at a time in each thread; what is in it is old.
std::vector<int>& RowScratch(int variables);

}  // namespace terse::internal
