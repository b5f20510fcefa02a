#pragma once
// The dense kernels of the Cholesky factor; part of dense_kernels_impl.h.

#include "cholesky/kernel_tiles.h"

namespace terse::internal {
namespace {
// y_c -= column c of A by x, for N columns and so many rows. Several columns at once keep as many streams from memory
// busy.
template <int N>
inline void SubtractDots(const double* a, long ld, const double* x, int rows, double* y) {
  if (rows < kWidth) {
    for (int i = 0; i < rows; ++i) {
      for (int c = 0; c < N; ++c) y[c] -= a[c * ld + i] * x[i];
    }
    return;
  }
  Vector sum[N] = {};
  int i = 0;
  for (; i + kWidth <= rows; i += kWidth) {
    const Vector value = Load(x + i);
    for (int c = 0; c < N; ++c) sum[c] += Load(a + c * ld + i) * value;
  }
  if (i < rows) {
    const Vector value = Load(x + rows - kWidth) * LastLanes(rows - i);
    for (int c = 0; c < N; ++c) sum[c] += Load(a + c * ld + rows - kWidth) * value;
  }
  for (int c = 0; c < N; ++c) y[c] -= Sum(sum[c]);
}

// x of the N pivots before `end`, first less what the pivots after them say, then with one another.
template <int N>
inline void SolveColumns(const double* panel, long ld, int pivots, int end, double* x) {
  const int begin = end - N;
  SubtractDots<N>(panel + begin * ld + end, ld, x + end, pivots - end, x + begin);
  for (int c = end - 1; c >= begin; --c) {
    const double* column = panel + c * ld;
    for (int k = c + 1; k < end; ++k) x[c] -= column[k] * x[k];
    x[c] /= column[c];
  }
}

// Reflections [1, v] with factor tau, one per column of L, each taking its column and the K columns of W with it.
// V vectors of rows.
template <int K, int V>
inline void Reflect(double* l, long ld, double* w, long ldw, int columns, const double (*v)[K], const double* tau) {
  Vector W[K][V];
  for (int k = 0; k < K; ++k) {
    for (int i = 0; i < V; ++i) W[k][i] = Load(w + k * ldw + i * kWidth);
  }
  for (int j = 0; j < columns; ++j) {
    Vector old[V], t[V];
    for (int i = 0; i < V; ++i) t[i] = old[i] = Load(l + j * ld + i * kWidth);
    for (int k = 0; k < K; ++k) {
      for (int i = 0; i < V; ++i) t[i] += v[j][k] * W[k][i];
    }
    for (int i = 0; i < V; ++i) {
      t[i] *= tau[j];
      Store(l + j * ld + i * kWidth, old[i] - t[i]);
    }
    for (int k = 0; k < K; ++k) {
      for (int i = 0; i < V; ++i) W[k][i] -= v[j][k] * t[i];
    }
  }
  for (int k = 0; k < K; ++k) {
    for (int i = 0; i < V; ++i) Store(w + k * ldw + i * kWidth, W[k][i]);
  }
}

constexpr int kRankBlock = 8;  // pivots at a time

// [L, W] Q = [L', 0] on the pivot rows, by Householder reflections.
template <int K>
void RankUpdateBlock(double* l, long ld, int rows, int pivots, double* w, long ldw) {
  double v[kRankBlock][K], tau[kRankBlock];
  for (int j = 0; j < pivots; ++j) {
    double norm2 = 0;
    for (int k = 0; k < K; ++k) norm2 += w[j + k * ldw] * w[j + k * ldw];
    double* column = l + j * ld;
    const double pivot = column[j];
    tau[j] = 0;
    for (int k = 0; k < K; ++k) v[j][k] = 0;
    // What is far below the rounding of the pivot changes nothing. What is not a number must show in the result.
    if (norm2 <= 1e-40 * pivot * pivot) continue;
    const double alpha = __builtin_sqrt(pivot * pivot + norm2);
    const double v0 = -norm2 / (pivot + alpha);  // pivot - alpha without cancellation
    tau[j] = 2 * v0 * v0 / (norm2 + v0 * v0);
    for (int k = 0; k < K; ++k) v[j][k] = w[j + k * ldw] / v0;
    column[j] = alpha;
    for (int i = j + 1; i < pivots; ++i) {
      double t = column[i];
      for (int k = 0; k < K; ++k) t += v[j][k] * w[i + k * ldw];
      t *= tau[j];
      column[i] -= t;
      for (int k = 0; k < K; ++k) w[i + k * ldw] -= v[j][k] * t;
    }
  }
  int i = pivots;
  constexpr int kVectors = TERSE_RANK_VECTORS;
  for (; i + kVectors * kWidth <= rows; i += kVectors * kWidth) {
    Reflect<K, kVectors>(l + i, ld, w + i, ldw, pivots, v, tau);
  }
  for (; i + kWidth <= rows; i += kWidth) Reflect<K, 1>(l + i, ld, w + i, ldw, pivots, v, tau);
  if (i == rows) return;
  double rest_l[kRankBlock * kWidth] = {}, rest_w[K * kWidth] = {};
  const int rest = rows - i;
  for (int j = 0; j < pivots; ++j) {
    for (int r = 0; r < rest; ++r) rest_l[j * kWidth + r] = l[j * ld + i + r];
  }
  for (int k = 0; k < K; ++k) {
    for (int r = 0; r < rest; ++r) rest_w[k * kWidth + r] = w[k * ldw + i + r];
  }
  Reflect<K, 1>(rest_l, kWidth, rest_w, kWidth, pivots, v, tau);
  for (int j = 0; j < pivots; ++j) {
    for (int r = 0; r < rest; ++r) l[j * ld + i + r] = rest_l[j * kWidth + r];
  }
  for (int k = 0; k < K; ++k) {
    for (int r = 0; r < rest; ++r) w[k * ldw + i + r] = rest_w[k * kWidth + r];
  }
}

}  // namespace

namespace TERSE_KERNEL_NAMESPACE {

int FactorPanel(double* panel, int leading, int rows, int pivots) {
  const long ld = leading;
  constexpr int kBlock = 8;
  for (int k = 0; k < pivots; k += kBlock) {
    const int width = pivots - k < kBlock ? pivots - k : kBlock;
    for (int j = k; j < k + width; ++j) {
      double* column = panel + j * ld;
      for (int i = k; i < j; ++i) Axpy(column + j, panel + i * ld + j, panel[i * ld + j], rows - j);
      const double pivot = column[j];
      if (!(pivot > 0) || !(pivot < 1e300)) return j;
      const double root = __builtin_sqrt(pivot);
      column[j] = root;
      Scale(column + j + 1, 1 / root, rows - j - 1);
    }
    const int next = k + width;
    const double* below = panel + k * ld + next;
    SubtractLower(panel + next * ld + next, ld, below, below, ld, rows - next, pivots - next, width);
  }
  return -1;
}

void SubtractProduct(double* c, int ldc, const double* a, const double* b, int ld, int rows, int columns, int depth) {
  SubtractLower(c, ldc, a, b, ld, rows, columns, depth);
}

void SetNegativeSquare(double* c, int ldc, const double* a, int ld, int rows, int columns, int depth) {
  const int first = depth < kDepth ? depth : kDepth;
  Lower<Into::kSetNegative>(c, ldc, a, a, ld, rows, columns, first);
  const double* rest = a + static_cast<long>(first) * ld;
  SubtractLower(c, ldc, rest, rest, ld, rows, columns, depth - first);
}

void RankUpdate(double* panel, int ld, int rows, int pivots, double* w, int ldw, int columns) {
  for (int j = 0; j < pivots; j += kRankBlock) {
    const int width = pivots - j < kRankBlock ? pivots - j : kRankBlock;
    double* l = panel + static_cast<long>(j) * ld + j;
    const auto from = [&](int k) { return w + static_cast<long>(k) * ldw + j; };
    int k = 0;
    for (; k + 6 <= columns; k += 6) RankUpdateBlock<6>(l, ld, rows - j, width, from(k), ldw);
    for (; k + 3 <= columns; k += 3) RankUpdateBlock<3>(l, ld, rows - j, width, from(k), ldw);
    for (; k < columns; ++k) RankUpdateBlock<1>(l, ld, rows - j, width, from(k), ldw);
  }
}

void BackSubstitute(const double* panel, int rows, int pivots, double* x) {
  const long ld = rows;
  // The separators are known: all columns of theirs before the triangle, which has to wait for itself.
  const int separators = rows - 1 - pivots;
  const auto below = [&](int j) { return panel + j * ld + pivots; };
  int begin = 0;
  for (; begin + 6 <= pivots; begin += 6) SubtractDots<6>(below(begin), ld, x + pivots, separators, x + begin);
  for (; begin + 3 <= pivots; begin += 3) SubtractDots<3>(below(begin), ld, x + pivots, separators, x + begin);
  for (; begin < pivots; ++begin) SubtractDots<1>(below(begin), ld, x + pivots, separators, x + begin);
  int end = pivots;
  for (; end >= 6; end -= 6) SolveColumns<6>(panel, ld, pivots, end, x);
  for (; end >= 3; end -= 3) SolveColumns<3>(panel, ld, pivots, end, x);
  for (; end > 0; --end) SolveColumns<1>(panel, ld, pivots, end, x);
}

}  // namespace TERSE_KERNEL_NAMESPACE
}  // namespace terse::internal
