// The dense kernels for one instruction set. Included by dense_kernels_*.cpp, each compiled for its own, after these
// are defined:
//   TERSE_KERNEL_NAMESPACE, TERSE_VECTOR_DOUBLES (per register), TERSE_TILE_VECTORS x TERSE_TILE_COLUMNS (register
//   tile), TERSE_RANK_VECTORS (of rows at a time in a rank update).
// Everything else has internal linkage and nothing from the standard library or Eigen is used: an inline function
// compiled here for a newer processor must not become the copy that the whole program runs.

#include "terse/core/dense_kernels.h"

namespace terse::internal {
namespace {

constexpr int kWidth = TERSE_VECTOR_DOUBLES;
constexpr int kTileVectors = TERSE_TILE_VECTORS;
constexpr int kTileColumns = TERSE_TILE_COLUMNS;
constexpr int kDepth = 128;  // columns at a time: a tile's operands stay in the first-level cache

typedef double Vector __attribute__((vector_size(kWidth * sizeof(double)), aligned(8), may_alias));

inline Vector Load(const double* p) { return *reinterpret_cast<const Vector*>(p); }
inline void Store(double* p, Vector v) { *reinterpret_cast<Vector*>(p) = v; }

// What becomes of C.
enum class Into { kSubtract, kSet, kAdd };

// C (V vectors of rows x N columns) -=, = or += A B', A and B with `depth` columns. `keep` is zero in the lanes of the
// last vector that another tile has done.
template <int V, int N, Into kInto>
inline void Tile(double* c, long ldc, const double* a, long lda, const double* b, long ldb, int depth,
                 const Vector* keep) {
  Vector sum[N][V] = {};
  for (int k = 0; k < depth; ++k) {
    Vector column[V];
    for (int v = 0; v < V; ++v) column[v] = Load(a + v * kWidth);
    for (int j = 0; j < N; ++j) {
      for (int v = 0; v < V; ++v) sum[j][v] += column[v] * b[j];
    }
    a += lda;
    b += ldb;
  }
  for (int j = 0; j < N; ++j) {
    double* to = c + j * ldc;
    if (keep != nullptr) {
      if (kInto == Into::kSet) {
        sum[j][V - 1] = *keep > 0 ? sum[j][V - 1] : Load(to + (V - 1) * kWidth);
      } else {
        sum[j][V - 1] *= *keep;
      }
    }
    for (int v = 0; v < V; ++v) {
      if (kInto == Into::kSet) {
        Store(to + v * kWidth, sum[j][v]);
      } else {
        const Vector old = Load(to + v * kWidth);
        Store(to + v * kWidth, kInto == Into::kAdd ? old + sum[j][v] : old - sum[j][v]);
      }
    }
  }
}

// One block of N columns, all rows.
template <int N, Into kInto>
void Columns(double* c, long ldc, const double* a, long lda, const double* b, long ldb, int rows, int depth) {
  int i = 0;
  for (; i + kTileVectors * kWidth <= rows; i += kTileVectors * kWidth) {
    Tile<kTileVectors, N, kInto>(c + i, ldc, a + i, lda, b, ldb, depth, nullptr);
  }
  for (; i + kWidth <= rows; i += kWidth) Tile<1, N, kInto>(c + i, ldc, a + i, lda, b, ldb, depth, nullptr);
  if (i == rows) return;
  if (rows >= kWidth) {
    // The last rows together with some that are done, whose lanes are cleared.
    Vector keep = {};
    for (int lane = 0; lane < kWidth; ++lane) keep[lane] = lane >= kWidth - (rows - i) ? 1.0 : 0.0;
    i = rows - kWidth;
    Tile<1, N, kInto>(c + i, ldc, a + i, lda, b, ldb, depth, &keep);
    return;
  }
  for (; i < rows; ++i) {
    for (int j = 0; j < N; ++j) {
      double sum = 0;
      for (int k = 0; k < depth; ++k) sum += a[i + k * lda] * b[j + k * ldb];
      double& to = c[i + j * ldc];
      to = kInto == Into::kSet ? sum : kInto == Into::kAdd ? to + sum : to - sum;
    }
  }
}

template <int N, Into kInto>
void ColumnsOf(int count, double* c, long ldc, const double* a, long lda, const double* b, long ldb, int rows,
               int depth) {
  if (count == N) {
    Columns<N, kInto>(c, ldc, a, lda, b, ldb, rows, depth);
  } else if constexpr (N > 1) {
    ColumnsOf<N - 1, kInto>(count, c, ldc, a, lda, b, ldb, rows, depth);
  }
}

// The lower trapezoid of C (rows x columns) -= A B', A with `rows` and B with `columns` rows. The upper triangles of
// tiles on the diagonal are written too: nobody reads them.
void SubtractLower(double* c, long ldc, const double* a, const double* b, long ld, int rows, int columns, int depth) {
  for (int k = 0; k < depth; k += kDepth) {
    const int d = depth - k < kDepth ? depth - k : kDepth;
    for (int j = 0; j < columns; j += kTileColumns) {
      const int n = columns - j < kTileColumns ? columns - j : kTileColumns;
      ColumnsOf<kTileColumns, Into::kSubtract>(n, c + j * ldc + j, ldc, a + k * ld + j, ld, b + k * ld + j, ld,
                                               rows - j, d);
    }
  }
}

// C (rows x columns) op A B'. To set, depth must be at most kDepth.
template <Into kInto>
void Rectangle(double* c, long ldc, const double* a, long lda, const double* b, long ldb, int rows, int columns,
               int depth) {
  for (int k = 0; k < depth; k += kDepth) {
    const int d = depth - k < kDepth ? depth - k : kDepth;
    for (int j = 0; j < columns; j += kTileColumns) {
      const int n = columns - j < kTileColumns ? columns - j : kTileColumns;
      ColumnsOf<kTileColumns, kInto>(n, c + j * ldc, ldc, a + k * lda, lda, b + k * ldb + j, ldb, rows, d);
    }
  }
}

// target[0..n) -= factor * source[0..n)
inline void Axpy(double* target, const double* source, double factor, int n) {
  int i = 0;
  for (; i + kWidth <= n; i += kWidth) Store(target + i, Load(target + i) - factor * Load(source + i));
  for (; i < n; ++i) target[i] -= factor * source[i];
}

inline void Scale(double* target, double factor, int n) {
  int i = 0;
  for (; i + kWidth <= n; i += kWidth) Store(target + i, factor * Load(target + i));
  for (; i < n; ++i) target[i] *= factor;
}

// The last lanes of a vector, as many as are wanted.
inline Vector LastLanes(int wanted) {
  Vector lanes;
  for (int lane = 0; lane < kWidth; ++lane) lanes[lane] = lane >= kWidth - wanted ? 1 : 0;
  return lanes;
}

inline double Sum(Vector v) {
  double lanes[kWidth];
  for (int lane = 0; lane < kWidth; ++lane) lanes[lane] = v[lane];
  for (int half = kWidth / 2; half > 0; half /= 2) {
    for (int lane = 0; lane < half; ++lane) lanes[lane] += lanes[lane + half];
  }
  return lanes[0];
}

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

// Vectors along the right-hand sides: W of them at a time, V vectors side by side.
template <int W>
struct LanesOf {
  typedef double Type __attribute__((vector_size(W * sizeof(double)), aligned(8), may_alias));
};

constexpr int kPivotBlock = 8, kLine = 8;  // doubles in a cache line

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
    for (int p = 0; p < N; ++p) __builtin_prefetch(below + (p - kPivotBlock) * ld + i0);
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

template <int W, int V>
void Forward(const double* l, long ld, int rows, int pivots, double* x, long stride) {
  for (int k = 0; k < pivots; k += kPivotBlock) {
    const int width = pivots - k < kPivotBlock ? pivots - k : kPivotBlock;
    ForwardBlock<W, V, kPivotBlock>(width, l + k * ld + k, ld, x + k * stride, stride);
    int r = k + width;
    for (; r + 8 <= rows; r += 8) {
      ForwardRows<W, V, 8>(l + k * ld + r, ld, width, x + k * stride, x + r * stride, stride);
    }
    for (; r + 3 <= rows; r += 3) {
      ForwardRows<W, V, 3>(l + k * ld + r, ld, width, x + k * stride, x + r * stride, stride);
    }
    for (; r < rows; ++r) ForwardRows<W, V, 1>(l + k * ld + r, ld, width, x + k * stride, x + r * stride, stride);
  }
}

template <int W, int V>
void Backward(const double* l, long ld, int rows, int pivots, double* x, long stride) {
  for (int next = pivots; next > 0;) {
    // The odd ones first, so that all other blocks are full.
    const int odd = next % kPivotBlock, width = odd == 0 ? kPivotBlock : odd, k = next - width;
    BackwardBlock<W, V, kPivotBlock>(width, l + k * ld + k, ld, rows - next, x + k * stride, stride);
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

// The rows of a square matrix, side by side in lanes; what is beyond them is zero.
template <int N>
struct MatrixRows {
  static constexpr int kPadded = N <= 4 ? 4 : 8;
  double row[N][kPadded] = {};

  explicit MatrixRows(const double* matrix) {
    for (int k = 0; k < N; ++k) {
      for (int i = 0; i < N; ++i) row[k][i] = matrix[i * N + k];
    }
  }
  // sign M' x.
  void Times(const double* x, double sign, double* out) const {
    double sum[kPadded] = {};
    for (int k = 0; k < N; ++k) {
      for (int i = 0; i < kPadded; ++i) sum[i] += row[k][i] * x[k];
    }
    for (int i = 0; i < N; ++i) out[i] = sign * sum[i];
  }
  // M' X.
  void TimesMatrix(const double* x, double* out) const {
    for (int j = 0; j < N; ++j) Times(x + j * N, 1, out + j * N);
  }
};

template <int N>
void FactorNormalBlocks(const double* a, const double* b, const double* r, double* H_first, double* H_second,
                        double* H_cross, double* b_first, double* b_second) {
  const MatrixRows<N> A(a);
  A.TimesMatrix(a, H_first);
  A.Times(r, -1, b_first);
  if (b == nullptr) return;
  const MatrixRows<N> B(b);
  B.TimesMatrix(b, H_second);
  B.TimesMatrix(a, H_cross);
  B.Times(r, -1, b_second);
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

void NormalBlocks(const double* a, const double* b, const double* r, int size, double* H_first, double* H_second,
                  double* H_cross, double* b_first, double* b_second) {
  const auto blocks = size == 6 ? FactorNormalBlocks<6> : FactorNormalBlocks<3>;
  blocks(a, b, r, H_first, H_second, H_cross, b_first, b_second);
}

void SubtractProduct(double* c, int ldc, const double* a, const double* b, int ld, int rows, int columns, int depth) {
  SubtractLower(c, ldc, a, b, ld, rows, columns, depth);
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
  for (int j = 0; j < pivots; ++j) x[j] = panel[j * ld + rows - 1];
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
