// The numbers of one front: assembly and partial factorisation.

#include <cmath>
#include <utility>

#include "dense_kernels.h"
#include "terse/core/block_cholesky.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

constexpr double kSingular = 4e-15;

// Where (row, column) of a front is stored: in the panel, or in the update matrix.
template <int B>
double* Target(typename BlockCholesky<B>::Front& front, int row, int column) {
  const int p = front.Columns(), rows = front.Rows();
  if (column < p) return front.panel.data() + At(column) * At(rows) + At(row);
  return front.update.data() + At(column - p) * At(rows - p) + At(row - p);
}

// Adds to the columns of a front, from (row, column) on.
template <int B, class Block>
void AddBlock(typename BlockCholesky<B>::Front& front, int row, int column, const Block& block) {
  using Map = Eigen::Map<Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;
  const int p = front.Columns(), rows = front.Rows();
  Map(Target<B>(front, row, column), Eigen::OuterStride<>(column < p ? rows : rows - p)) += block;
}

template <int B>
void AddRightHandSide(typename BlockCholesky<B>::Front& front, int column, const double* b, size_t stride) {
  const size_t step = At(column < front.Columns() ? front.Rows() : front.Rows() - front.Columns());
  double* target = Target<B>(front, front.Rows() - 1, column);
  for (size_t k = 0; k < B; ++k) target[k * step] += b[k * stride];
}

void ClearLower(double* matrix, int rows, int columns) {
  for (int c = 0; c < columns; ++c) std::fill_n(matrix + At(c) * At(rows) + At(c), rows - c, 0.0);
}

}  // namespace

// Returns the variable at which the matrix was found not to be positive definite, or -1. The front has its buffers.
template <int B>
int BlockCholesky<B>::FactorFront(Front& front, const std::vector<Front>& pending, const std::vector<double>& damping) {
  const int rows = front.Rows(), p = front.Columns(), n = rows - p;
  ClearLower(front.panel.data(), rows, p);
  ClearLower(front.update.data(), n, n);
  front.update_separators = static_cast<int>(front.separators.size());
  front.corrections.clear();
  int row = 0;
  for (const int v : front.pivots) row_of_[At(v)] = std::exchange(row, row + B);
  for (const int v : front.separators) row_of_[At(v)] = std::exchange(row, row + B);
  for (const int slot : front.slots) AssembleFactor(front, slot);
  for (const int child : front.children) AssembleChild(front, child < 0 ? pending[At(-1 - child)] : fronts_[At(child)]);
  if (!damping.empty()) {
    for (int c = 0; c < p; ++c) {
      front.panel[At(c) * At(rows) + At(c)] += damping[At(front.pivots[At(c / B)]) * B + At(c % B)];
    }
  }
  const auto& kernels = internal::Kernels();
  const int failed = kernels.factor_panel(front.panel.data(), rows, p);
  if (failed >= 0) return front.pivots[At(failed / B)];
  const double* below = front.panel.data() + p;
  kernels.subtract_product(front.update.data(), n, below, below, rows, p);
  return SumPivots(front, 0);
}

// What the pivots add up to; returns the first variable from a column on that nothing measures, or -1.
template <int B>
int BlockCholesky<B>::SumPivots(Front& front, int first_column) const {
  const int rows = front.Rows(), p = front.Columns();
  front.log_det = front.y2 = 0;
  for (int c = 0; c < p; ++c) {
    const double* column = front.panel.data() + At(c) * At(rows);
    const double pivot = column[c], y = column[rows - 1];
    // What is left of a direction that nothing measures is rounding of what was assembled.
    if (c >= first_column && !(pivot * pivot > kSingular * diagonal_[At(front.pivots[At(c / B)])][c % B])) {
      return front.pivots[At(c / B)];
    }
    front.log_det += 2 * std::log(pivot);
    front.y2 += y * y;
  }
  return std::isfinite(front.y2) ? -1 : front.pivots.front();
}

template <int B>
void BlockCholesky<B>::AssembleFactor(Front& front, int slot) {
  const LinearFactor<B>& f = factors_[At(slot)];
  const Normal& normal = normals_[At(slot)];
  const int i = row_of_[At(f.first)];
  AddBlock<B>(front, i, i, normal.H_first);
  AddRightHandSide<B>(front, i, normal.b_first.data(), 1);
  if (f.second < 0) return;
  const int j = row_of_[At(f.second)];
  AddBlock<B>(front, j, j, normal.H_second);
  AddRightHandSide<B>(front, j, normal.b_second.data(), 1);
  if (i > j) {
    AddBlock<B>(front, i, j, normal.H_cross.transpose());
  } else {
    AddBlock<B>(front, j, i, normal.H_cross);
  }
}

// Extend-add of a child's update matrix. A kept child's separator order may be stale: its ancestors were ordered
// again since, so a block can land transposed. Separators that stay neighbours are added as one run.
template <int B>
void BlockCholesky<B>::AssembleChild(Front& front, const Front& child) {
  const int blocks = child.update_separators;
  const int n = blocks * B + 1;
  const auto row = [&](int k) { return row_of_[At(child.separators[At(k)])]; };
  for (int j = 0; j < blocks; ++j) {
    const int cj = row(j);
    const double* columns = child.update.data() + At(j * B) * At(n);
    for (int i = j; i < blocks;) {
      const int ci = row(i);
      if (ci < cj) {
        using Source = Eigen::Map<const Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;
        AddBlock<B>(front, cj, ci, Source(columns + i * B, Eigen::OuterStride<>(n)).transpose());
        ++i;
        continue;
      }
      int end = i + 1;
      while (end < blocks && row(end) == ci + (end - i) * B) ++end;
      const size_t step = At(cj < front.Columns() ? front.Rows() : front.Rows() - front.Columns());
      double* target = Target<B>(front, ci, cj);
      for (int c = 0; c < B; ++c) {
        const double* source = columns + At(c) * At(n) + At(i * B);
        double* to = target + At(c) * step;
        const int length = (end - i) * B;
        for (int k = i == j ? c : 0; k < length; ++k) to[k] += source[k];
      }
      i = end;
    }
    AddRightHandSide<B>(front, cj, columns + At(n - 1), At(n));
  }
}

// Brings the update matrix up to date.
template <int B>
void BlockCholesky<B>::WorkInCorrections(Front& front) {
  if (front.corrections.empty()) return;
  const int n = B * static_cast<int>(front.separators.size()) + 1, old = B * front.update_separators + 1;
  if (n != old) {
    std::vector<double> wider = pool_.Take(At(n) * At(n));
    ClearLower(wider.data(), n, n);
    for (int c = 0; c < old - 1; ++c) {
      const double* from = front.update.data() + At(c) * At(old);
      double* to = wider.data() + At(c) * At(n);
      std::copy(from + c, from + old - 1, to + c);
      to[n - 1] = from[old - 1];
    }
    front.update.swap(wider);
    front.update_separators = static_cast<int>(front.separators.size());
    pool_.MakeRoom(wider.size());
    pool_.Give(std::move(wider));
  }
  int depth = 0;
  for (const Correction& c : front.corrections) depth += c.columns;
  std::vector<double> W(At(n) * At(depth), 0.0);
  double* column = W.data();
  for (const Correction& c : front.corrections) {
    const int rows = B * c.separators + 1;
    for (int k = 0; k < c.columns; ++k, column += n) {
      const double* from = c.W.data() + At(k) * At(rows);
      std::copy(from, from + rows - 1, column);
      column[n - 1] = from[rows - 1];
    }
  }
  std::vector<double> negative(W);
  for (double& x : negative) x = -x;
  internal::Kernels().subtract_product(front.update.data(), n, W.data(), negative.data(), n, depth);
  front.corrections.clear();
}

#define TERSE_INSTANTIATE(B)                                                                                 \
  template int BlockCholesky<B>::FactorFront(Front&, const std::vector<Front>&, const std::vector<double>&); \
  template int BlockCholesky<B>::SumPivots(Front&, int) const;                                               \
  template void BlockCholesky<B>::AssembleFactor(Front&, int);                                               \
  template void BlockCholesky<B>::AssembleChild(Front&, const Front&);                                       \
  template void BlockCholesky<B>::WorkInCorrections(Front&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
