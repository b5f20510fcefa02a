#pragma once
// Products by register tiles, and what else the dense kernels share; part of dense_kernels_impl.h.

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
enum class Into { kSubtract, kSet, kSetNegative, kAdd };
constexpr bool Sets(Into into) { return into == Into::kSet || into == Into::kSetNegative; }

// C (V vectors of rows x N columns) -=, =, = - or += A B', A and B with `depth` columns. `keep` is zero in the lanes of
// the last vector that another tile has done.
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
    if (kInto == Into::kSetNegative) {
      for (int v = 0; v < V; ++v) sum[j][v] = -sum[j][v];
    }
    if (keep != nullptr) {
      if (Sets(kInto)) {
        sum[j][V - 1] = *keep > 0 ? sum[j][V - 1] : Load(to + (V - 1) * kWidth);
      } else {
        sum[j][V - 1] *= *keep;
      }
    }
    for (int v = 0; v < V; ++v) {
      if (Sets(kInto)) {
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
      to = Sets(kInto) ? (kInto == Into::kSet ? sum : -sum) : kInto == Into::kAdd ? to + sum : to - sum;
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

// The lower trapezoid of C (rows x columns) op A B', A with `rows` and B with `columns` rows, depth at most kDepth. The
// upper triangles of tiles on the diagonal are written too: nobody reads them.
template <Into kInto>
void Lower(double* c, long ldc, const double* a, const double* b, long ld, int rows, int columns, int depth) {
  for (int j = 0; j < columns; j += kTileColumns) {
    const int n = columns - j < kTileColumns ? columns - j : kTileColumns;
    ColumnsOf<kTileColumns, kInto>(n, c + j * ldc + j, ldc, a + j, ld, b + j, ld, rows - j, depth);
  }
}

void SubtractLower(double* c, long ldc, const double* a, const double* b, long ld, int rows, int columns, int depth) {
  for (int k = 0; k < depth; k += kDepth) {
    const int d = depth - k < kDepth ? depth - k : kDepth;
    Lower<Into::kSubtract>(c, ldc, a + k * ld, b + k * ld, ld, rows, columns, d);
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

}  // namespace
}  // namespace terse::internal
