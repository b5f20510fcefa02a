// The dense kernels for one instruction set. Included by dense_kernels_*.cpp, each compiled for its own, after these
// are defined:
//   TERSE_KERNEL_NAMESPACE, TERSE_VECTOR_DOUBLES (per register), TERSE_TILE_VECTORS x TERSE_TILE_COLUMNS (register
//   tile).
// Everything else has internal linkage and nothing from the standard library or Eigen is used: an inline function
// compiled here for a newer processor must not become the copy that the whole program runs.

#include "dense_kernels.h"

namespace terse::internal {
namespace {

constexpr int kWidth = TERSE_VECTOR_DOUBLES;
constexpr int kTileVectors = TERSE_TILE_VECTORS;
constexpr int kTileColumns = TERSE_TILE_COLUMNS;
constexpr int kDepth = 128;  // columns at a time: a tile's operands stay in the first-level cache

typedef double Vector __attribute__((vector_size(kWidth * sizeof(double)), aligned(8), may_alias));

inline Vector Load(const double* p) { return *reinterpret_cast<const Vector*>(p); }
inline void Store(double* p, Vector v) { *reinterpret_cast<Vector*>(p) = v; }

// C (V vectors of rows x N columns) -= A B', A and B with `depth` columns. `keep` zeroes lanes of the last vector
// that another tile has done.
template <int V, int N>
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
    if (keep != nullptr) sum[j][V - 1] *= *keep;
    for (int v = 0; v < V; ++v) Store(c + j * ldc + v * kWidth, Load(c + j * ldc + v * kWidth) - sum[j][v]);
  }
}

// One block of N columns, all rows.
template <int N>
void Columns(double* c, long ldc, const double* a, long lda, const double* b, long ldb, int rows, int depth) {
  int i = 0;
  for (; i + kTileVectors * kWidth <= rows; i += kTileVectors * kWidth) {
    Tile<kTileVectors, N>(c + i, ldc, a + i, lda, b, ldb, depth, nullptr);
  }
  for (; i + kWidth <= rows; i += kWidth) Tile<1, N>(c + i, ldc, a + i, lda, b, ldb, depth, nullptr);
  if (i == rows) return;
  if (rows >= kWidth) {
    // The last rows together with some that are done, whose lanes are cleared.
    Vector keep = {};
    for (int lane = 0; lane < kWidth; ++lane) keep[lane] = lane >= kWidth - (rows - i) ? 1.0 : 0.0;
    i = rows - kWidth;
    Tile<1, N>(c + i, ldc, a + i, lda, b, ldb, depth, &keep);
    return;
  }
  for (; i < rows; ++i) {
    for (int j = 0; j < N; ++j) {
      double sum = 0;
      for (int k = 0; k < depth; ++k) sum += a[i + k * lda] * b[j + k * ldb];
      c[i + j * ldc] -= sum;
    }
  }
}

template <int N>
void ColumnsOf(int count, double* c, long ldc, const double* a, long lda, const double* b, long ldb, int rows,
               int depth) {
  if (count == N) {
    Columns<N>(c, ldc, a, lda, b, ldb, rows, depth);
  } else if constexpr (N > 1) {
    ColumnsOf<N - 1>(count, c, ldc, a, lda, b, ldb, rows, depth);
  }
}

// The lower trapezoid of C (rows x columns) -= A A', of which A's first `columns` rows are the right factor. The
// upper triangles of tiles on the diagonal are written too: nobody reads them.
void SubtractLower(double* c, long ldc, const double* a, long lda, int rows, int columns, int depth) {
  for (int k = 0; k < depth; k += kDepth) {
    const int d = depth - k < kDepth ? depth - k : kDepth;
    const double* from = a + k * lda;
    for (int j = 0; j < columns; j += kTileColumns) {
      const int n = columns - j < kTileColumns ? columns - j : kTileColumns;
      ColumnsOf<kTileColumns>(n, c + j * ldc + j, ldc, from + j, lda, from + j, lda, rows - j, d);
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

}  // namespace

namespace TERSE_KERNEL_NAMESPACE {

int FactorPanel(double* panel, int rows, int pivots) {
  const long ld = rows;
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
    SubtractLower(panel + next * ld + next, ld, panel + k * ld + next, ld, rows - next, pivots - next, width);
  }
  return -1;
}

void SubtractOuter(double* update, int n, const double* panel, int rows, int pivots) {
  SubtractLower(update, n, panel + (rows - n), rows, n, n, pivots);
}

}  // namespace TERSE_KERNEL_NAMESPACE
}  // namespace terse::internal
