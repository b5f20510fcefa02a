#pragma once
// The dense kernels of covariances; part of dense_kernels_impl.h.

#include "cholesky/kernel_tiles.h"
#include "terse/core/dense_kernels.h"

namespace terse::internal {
namespace {
// Vectors along the right-hand sides: W of them at a time, V vectors side by side.
template <int W>
struct LanesOf {
  typedef double Type __attribute__((vector_size(W * sizeof(double)), aligned(8), may_alias));
};

constexpr int kLine = 8;  // doubles in a cache line
// Rows of V vectors that fit in registers: SSE2 and AVX2 have 16 of them, AVX-512 32.
template <int W, int V>
constexpr int MostRows() {
  return W <= 4 && V == 2 ? 6 : 8;
}

// x[i0 + r] -= sum_j L(i0 + r, j) x[j] for r < N rows; L column-major.
template <int W, int V, int N>
inline void ForwardRows(const double* l, long ld, int pivots, const double* x, double* y, long stride) {
  using Lanes = typename LanesOf<W>::Type;
  Lanes sum[N][V] = {};
  for (int j = 0; j < pivots; ++j) {
    Lanes xj[V];
    for (int v = 0; v < V; ++v) xj[v] = *reinterpret_cast<const Lanes*>(x + j * stride + v * W);
    for (int r = 0; r < N; ++r) {
      for (int v = 0; v < V; ++v) sum[r][v] += l[j * ld + r] * xj[v];
    }
  }
  for (int r = 0; r < N; ++r) {
    for (int v = 0; v < V; ++v) *reinterpret_cast<Lanes*>(y + r * stride + v * W) -= sum[r][v];
  }
}

// N pivots, their rows of x in registers: x_P = L_PP^-1 x_P.
template <int W, int V, int N>
inline void ForwardPivots(const double* l, long ld, double* x, long stride) {
  using Lanes = typename LanesOf<W>::Type;
  Lanes row[N][V];
  for (int p = 0; p < N; ++p) {
    for (int v = 0; v < V; ++v) row[p][v] = *reinterpret_cast<const Lanes*>(x + p * stride + v * W);
  }
  for (int p = 0; p < N; ++p) {
    const double inverse = 1 / l[p * ld + p];
    for (int v = 0; v < V; ++v) {
      row[p][v] *= inverse;
      *reinterpret_cast<Lanes*>(x + p * stride + v * W) = row[p][v];
      for (int q = p + 1; q < N; ++q) row[q][v] -= l[p * ld + q] * row[p][v];
    }
  }
}

// N pivots: x_P = L_PP^-T (x_P - L_RP' x_R), `rows` rows in R.
template <int W, int V, int N>
inline void BackwardPivots(const double* l, long ld, int rows, double* x, long stride) {
  using Lanes = typename LanesOf<W>::Type;
  Lanes row[N][V];
  for (int p = 0; p < N; ++p) {
    for (int v = 0; v < V; ++v) row[p][v] = *reinterpret_cast<const Lanes*>(x + p * stride + v * W);
  }
  const double* below = l + N;
  const double* x_below = x + N * stride;
  for (int i0 = 0; i0 < rows; i0 += kLine) {
    // The columns that come next: short ones start too late for the processor to see them coming.
    for (int p = 0; p < N; ++p) __builtin_prefetch(below + (p - MostRows<W, V>()) * ld + i0);
    const int end = i0 + kLine < rows ? i0 + kLine : rows;
    for (int i = i0; i < end; ++i) {
      Lanes xi[V];
      for (int v = 0; v < V; ++v) xi[v] = *reinterpret_cast<const Lanes*>(x_below + i * stride + v * W);
      for (int p = 0; p < N; ++p) {
        for (int v = 0; v < V; ++v) row[p][v] -= below[p * ld + i] * xi[v];
      }
    }
  }
  for (int p = N - 1; p >= 0; --p) {
    const double inverse = 1 / l[p * ld + p];
    for (int v = 0; v < V; ++v) {
      row[p][v] *= inverse;
      *reinterpret_cast<Lanes*>(x + p * stride + v * W) = row[p][v];
      for (int q = 0; q < p; ++q) row[q][v] -= l[q * ld + p] * row[p][v];
    }
  }
}

template <int W, int V, int N>
inline void ForwardBlock(int width, const double* l, long ld, double* x, long stride) {
  if (width == N) {
    ForwardPivots<W, V, N>(l, ld, x, stride);
  } else if constexpr (N > 1) {
    ForwardBlock<W, V, N - 1>(width, l, ld, x, stride);
  }
}

template <int W, int V, int N>
inline void BackwardBlock(int width, const double* l, long ld, int rows, double* x, long stride) {
  if (width == N) {
    BackwardPivots<W, V, N>(l, ld, rows, x, stride);
  } else if constexpr (N > 1) {
    BackwardBlock<W, V, N - 1>(width, l, ld, rows, x, stride);
  }
}

// All pivots of a block have their rows of x in registers, one vector of each where there is no room for more; the rows
// below as many as fit.
template <int W, int V>
void Forward(const double* l, long ld, int rows, int pivots, double* x, long stride) {
  constexpr int kBlock = 8, kRows = MostRows<W, V>(), kPivotVectors = kRows < kBlock ? 1 : V;
  for (int k = 0; k < pivots; k += kBlock) {
    const int width = pivots - k < kBlock ? pivots - k : kBlock;
    for (int v = 0; v < V; v += kPivotVectors) {
      ForwardBlock<W, kPivotVectors, kBlock>(width, l + k * ld + k, ld, x + k * stride + v * W, stride);
    }
    int r = k + width;
    for (; r + kRows <= rows; r += kRows) {
      ForwardRows<W, V, kRows>(l + k * ld + r, ld, width, x + k * stride, x + r * stride, stride);
    }
    for (; r + 3 <= rows; r += 3) {
      ForwardRows<W, V, 3>(l + k * ld + r, ld, width, x + k * stride, x + r * stride, stride);
    }
    for (; r < rows; ++r) ForwardRows<W, V, 1>(l + k * ld + r, ld, width, x + k * stride, x + r * stride, stride);
  }
}

template <int W, int V>
void Backward(const double* l, long ld, int rows, int pivots, double* x, long stride) {
  constexpr int kBlock = MostRows<W, V>();
  for (int next = pivots; next > 0;) {
    // The odd ones first, so that all other blocks are full.
    const int odd = next % kBlock, width = odd == 0 ? kBlock : odd, k = next - width;
    BackwardBlock<W, V, kBlock>(width, l + k * ld + k, ld, rows - next, x + k * stride, stride);
    next = k;
  }
}

// N rows of Y -= X T, or Y = X T; all are read before any is written.
template <int W, int V, int N, bool kSet>
inline void Rows(double* y, long ldy, const double* x, long ldx, const double* t, long ldt, int depth) {
  using Lanes = typename LanesOf<W>::Type;
  Lanes sum[N][V] = {};
  for (int k = 0; k < depth; ++k) {
    Lanes tk[V];
    for (int v = 0; v < V; ++v) tk[v] = *reinterpret_cast<const Lanes*>(t + k * ldt + v * W);
    for (int r = 0; r < N; ++r) {
      for (int v = 0; v < V; ++v) sum[r][v] += x[r * ldx + k] * tk[v];
    }
  }
  for (int r = 0; r < N; ++r) {
    for (int v = 0; v < V; ++v) {
      Lanes& to = *reinterpret_cast<Lanes*>(y + r * ldy + v * W);
      to = kSet ? sum[r][v] : to - sum[r][v];
    }
  }
}

template <int W, int V, bool kSet>
void AllRows(double* y, long ldy, const double* x, long ldx, const double* t, long ldt, int rows, int depth) {
  int r = 0;
  for (; r + 6 <= rows; r += 6) Rows<W, V, 6, kSet>(y + r * ldy, ldy, x + r * ldx, ldx, t, ldt, depth);
  for (; r < rows; ++r) Rows<W, V, 1, kSet>(y + r * ldy, ldy, x + r * ldx, ldx, t, ldt, depth);
}

// Calls do_lanes<W, V>(first column) for vectors that cover `columns` columns.
template <class DoLanes>
inline void ForLanes(int columns, const DoLanes& do_lanes) {
  int c = 0;
  if constexpr (kWidth >= 8) {
    for (; c + 16 <= columns; c += 16) do_lanes.template operator()<8, 2>(c);
    for (; c + 8 <= columns; c += 8) do_lanes.template operator()<8, 1>(c);
    for (; c < columns; c += 4) do_lanes.template operator()<4, 1>(c);
  } else {
    if constexpr (kWidth == 4) {
      for (; c + 8 <= columns; c += 8) do_lanes.template operator()<4, 2>(c);
    }
    for (; c < columns; c += 4) do_lanes.template operator()<kWidth, 4 / kWidth>(c);
  }
}

template <bool kBackward>
struct SubstitutionLanes {
  const double* l;
  long ld;
  int rows, pivots;
  double* x;
  long stride;
  template <int W, int V>
  void operator()(int c) const {
    if constexpr (kBackward) {
      Backward<W, V>(l, ld, rows, pivots, x + c, stride);
    } else {
      Forward<W, V>(l, ld, rows, pivots, x + c, stride);
    }
  }
};

struct RowLanes {
  double* y;
  long ldy;
  const double* x;
  long ldx;
  const double* t;
  long ldt;
  int rows, depth;
  template <int W, int V>
  void operator()(int c) const {
    AllRows<W, V, false>(y + c, ldy, x, ldx, t + c, ldt, rows, depth);
  }
};

// S (N x N) -= the symmetric part of Y M Y', a vector of M's columns at a time.
template <int N>
inline void SubtractCongruence(double* s, const double* y, long stride, const double* m, int depth) {
  constexpr int kPadded = N <= 4 ? 4 : 8, W = kWidth < kPadded ? kWidth : kPadded, kVectors = kPadded / W;
  constexpr int kColumns = kWidth < 4 ? kWidth : 4;
  using Lanes = typename LanesOf<W>::Type;
  using ColumnLanes = typename LanesOf<kColumns>::Type;
  Lanes sum[N][kVectors] = {};
  double columns[kColumns][kPadded] = {};
  for (int c = 0; c < depth; c += kColumns) {
    // Written here and read as vectors later, when the single values have arrived.
    for (int r = 0; r < N; ++r) {
      for (int i = 0; i < kColumns; ++i) columns[i][r] = y[r * stride + c + i];
    }
    ColumnLanes t[N] = {};
    for (int k = 0; k < depth; ++k) {
      const ColumnLanes row = *reinterpret_cast<const ColumnLanes*>(m + k * stride + c);
      for (int r = 0; r < N; ++r) t[r] += y[r * stride + k] * row;
    }
    for (int i = 0; i < kColumns; ++i) {
      for (int v = 0; v < kVectors; ++v) {
        const Lanes column = *reinterpret_cast<const Lanes*>(columns[i] + v * W);
        for (int r = 0; r < N; ++r) sum[r][v] += t[r][i] * column;
      }
    }
  }
  double full[N][kPadded];
  for (int r = 0; r < N; ++r) {
    for (int v = 0; v < kVectors; ++v) *reinterpret_cast<Lanes*>(full[r] + v * W) = sum[r][v];
  }
  for (int r = 0; r < N; ++r) {
    for (int c = 0; c < N; ++c) s[r * N + c] -= 0.5 * (full[r][c] + full[c][r]);
  }
}

}  // namespace

namespace TERSE_KERNEL_NAMESPACE {

void AddRectangle(double* c, int ldc, const double* a, int lda, const double* b, int ldb, int rows, int columns,
                  int depth) {
  Rectangle<Into::kAdd>(c, ldc, a, lda, b, ldb, rows, columns, depth);
}

void SetRectangle(double* c, int ldc, const double* a, int lda, const double* b, int ldb, int rows, int columns,
                  int depth) {
  const int first = depth < kDepth ? depth : kDepth;
  Rectangle<Into::kSet>(c, ldc, a, lda, b, ldb, rows, columns, first);
  Rectangle<Into::kAdd>(c, ldc, a + static_cast<long>(first) * lda, lda, b + static_cast<long>(first) * ldb, ldb, rows,
                        columns, depth - first);
}

void SubstituteForward(const double* panel, int ld, int rows, int pivots, double* x, int stride) {
  ForLanes(stride, SubstitutionLanes<false>{panel, ld, rows, pivots, x, stride});
}

void SubstituteBackward(const double* panel, int ld, int rows, int pivots, double* x, int stride) {
  ForLanes(stride, SubstitutionLanes<true>{panel, ld, rows, pivots, x, stride});
}

void SubtractRows(double* y, int ldy, const double* x, int ldx, const double* t, int ldt, int rows, int depth,
                  int width) {
  ForLanes(width, RowLanes{y, ldy, x, ldx, t, ldt, rows, depth});
}

void TransformRows(double* y, int stride, const double* t, int rows, int depth) {
  constexpr int kHalf = kWidth < kLanes ? kWidth : kLanes;
  if (stride == kLanes) {
    AllRows<kHalf, kLanes / kHalf, true>(y, stride, y, stride, t, stride, rows, depth);
  } else {
    AllRows<kWidth, 2 * kLanes / kWidth, true>(y, stride, y, stride, t, stride, rows, depth);
  }
}

void SubtractCongruences(double* s, const double* y, int stride, const double* m, int count, int size, int depth) {
  for (long k = 0; k < count; ++k) {
    const double* block = y + k * size * stride;
    if (size == 3) {
      SubtractCongruence<3>(s + k * 9, block, stride, m, depth);
    } else if (size == 6) {
      SubtractCongruence<6>(s + k * 36, block, stride, m, depth);
    }
  }
}

}  // namespace TERSE_KERNEL_NAMESPACE
}  // namespace terse::internal
