// The numbers of one front: assembly and partial factorisation.

#include <cmath>
#include <utility>

#include "dense_kernels.h"
#include "terse/core/block_cholesky.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

template <int B>
using BlockMap = Eigen::Map<Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;
template <int B>
using ConstBlockMap = Eigen::Map<const Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;

// The stored block (row, column) of a front, in the panel or in the update matrix.
template <int B>
BlockMap<B> Target(typename BlockCholesky<B>::Front& front, int row, int column) {
  const int p = front.Columns(), rows = front.Rows();
  if (column < p) {
    return BlockMap<B>(front.panel.data() + At(column) * At(rows) + At(row), Eigen::OuterStride<>(rows));
  }
  const int n = rows - p;
  return BlockMap<B>(front.update.data() + At(column - p) * At(n) + At(row - p), Eigen::OuterStride<>(n));
}

// The right-hand side's entries of a variable at `column`; `stride` apart.
template <int B>
double* RightHandSide(typename BlockCholesky<B>::Front& front, int column, int& stride) {
  const int p = front.Columns(), rows = front.Rows(), n = rows - p;
  stride = column < p ? rows : n;
  return column < p ? front.panel.data() + At(column) * At(rows) + At(rows - 1)
                    : front.update.data() + At(column - p) * At(n) + At(n - 1);
}

}  // namespace

// Returns the variable at which the matrix was found not to be positive definite, or -1.
template <int B>
int BlockCholesky<B>::FactorFront(Front& front, const std::vector<Front>& pending, const std::vector<double>& damping) {
  const int rows = front.Rows(), p = front.Columns(), n = rows - p;
  front.panel.assign(At(rows) * At(p), 0.0);
  front.update.assign(At(n) * At(n), 0.0);
  int row = 0;
  for (const int v : front.pivots) row_of_[At(v)] = std::exchange(row, row + B);
  for (const int v : front.separators) row_of_[At(v)] = std::exchange(row, row + B);
  for (const int slot : front.slots) AssembleFactor(front, factors_[At(slot)]);
  front.subtree_log_det = front.subtree_y2 = 0;
  for (const int child : front.children) {
    const Front& c = child < 0 ? pending[At(-1 - child)] : fronts_[At(child)];
    AssembleChild(front, c);
    front.subtree_log_det += c.subtree_log_det;
    front.subtree_y2 += c.subtree_y2;
  }
  if (!damping.empty()) {
    for (int c = 0; c < p; ++c) {
      front.panel[At(c) * At(rows) + At(c)] += damping[At(front.pivots[At(c / B)]) * B + At(c % B)];
    }
  }
  const int failed = internal::Kernels().factor_panel(front.panel.data(), rows, p);
  if (failed >= 0) return front.pivots[At(failed / B)];
  internal::Kernels().subtract_outer(front.update.data(), n, front.panel.data(), rows, p);
  for (int c = 0; c < p; ++c) {
    front.subtree_log_det += 2 * std::log(front.panel[At(c) * At(rows) + At(c)]);
    const double y = front.panel[At(c) * At(rows) + At(rows - 1)];
    front.subtree_y2 += y * y;
  }
  front.fresh = true;
  return -1;
}

template <int B>
void BlockCholesky<B>::AssembleFactor(Front& front, const LinearFactor<B>& f) {
  int stride = 0;
  const auto add_variable = [&](int variable, const Matrix<B, B>& A) {
    const int at = row_of_[At(variable)];
    Target<B>(front, at, at).noalias() += A.transpose() * A;
    double* b = RightHandSide<B>(front, at, stride);
    const Vector<B> rhs = -(A.transpose() * f.residual);
    for (int k = 0; k < B; ++k) b[k * stride] += rhs[k];
  };
  add_variable(f.first, f.A_first);
  if (f.second < 0) return;
  add_variable(f.second, f.A_second);
  const int i = row_of_[At(f.first)], j = row_of_[At(f.second)];
  if (i > j) {
    Target<B>(front, i, j).noalias() += f.A_first.transpose() * f.A_second;
  } else {
    Target<B>(front, j, i).noalias() += f.A_second.transpose() * f.A_first;
  }
}

// Extend-add of a child's update matrix. A kept child's separator order may be stale: its ancestors were ordered
// again since, so a block can land transposed.
template <int B>
void BlockCholesky<B>::AssembleChild(Front& front, const Front& child) {
  const int blocks = static_cast<int>(child.separators.size());
  const int n = blocks * B + 1;
  for (int j = 0; j < blocks; ++j) {
    const int cj = row_of_[At(child.separators[At(j)])];
    const double* column = child.update.data() + At(j * B) * At(n);
    for (int i = j; i < blocks; ++i) {
      const int ci = row_of_[At(child.separators[At(i)])];
      const ConstBlockMap<B> source(column + i * B, Eigen::OuterStride<>(n));
      if (ci >= cj) {
        Target<B>(front, ci, cj) += source;
      } else {
        Target<B>(front, cj, ci) += source.transpose();
      }
    }
    int stride = 0;
    double* b = RightHandSide<B>(front, cj, stride);
    for (int k = 0; k < B; ++k) b[k * stride] += column[At(k) * At(n) + At(n - 1)];
  }
}

#define TERSE_INSTANTIATE(B)                                                                                 \
  template int BlockCholesky<B>::FactorFront(Front&, const std::vector<Front>&, const std::vector<double>&); \
  template void BlockCholesky<B>::AssembleFactor(Front&, const LinearFactor<B>&);                            \
  template void BlockCholesky<B>::AssembleChild(Front&, const Front&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
