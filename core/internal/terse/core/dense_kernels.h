#pragma once
// Dense kernels on column-major fronts, compiled for several instruction sets; the best one that the processor runs
// is chosen at start. No Eigen type crosses this boundary. Only lower triangles are meaningful.

#include <vector>

namespace terse::internal {

struct DenseKernels {
  const char* name;
  // In place on the first `pivots` columns of a lower-trapezoidal panel with `rows` rows and leading dimension
  // ld: top = L L', bottom = bottom L^-T. Returns the column whose pivot is not positive and finite, or -1.
  int (*factor_panel)(double* panel, int ld, int rows, int pivots);
  // Lower trapezoid of C (rows x columns, leading dimension ldc) -= A B', A rows x depth, B columns x depth, both with
  // leading dimension ld.
  void (*subtract_product)(double* c, int ldc, const double* a, const double* b, int ld, int rows, int columns,
                           int depth);
  // Lower trapezoid of C = -A A', A rows x depth with leading dimension ld; depth at least one.
  void (*set_negative_square)(double* c, int ldc, const double* a, int ld, int rows, int columns, int depth);
  // The first `pivots` columns of [L; y'] (rows x pivots, lower trapezoidal, leading dimension ld) become those of
  // L L' + W W', W having `columns` columns and the same rows. What W holds in its other rows afterwards is the update
  // of what is below. Pivots may be zero.
  void (*rank_update)(double* panel, int ld, int rows, int pivots, double* w, int ldw, int columns);
  // x_P = L_PP^-T (x_P - L_SP' x_S), x the pivots, then the separators, one less than the rows of the panel.
  void (*back_substitute)(const double* panel, int rows, int pivots, double* x);

  // What a linear factor adds to the normal equations: H_first = A'A, b_first = -A'r and, unless B is null, H_second =
  // B'B, H_cross = B'A and b_second = -B'r, all contiguous. Size 3 or 6.
  void (*normal_blocks)(const double* a, const double* b, const double* r, int size, double* H_first, double* H_second,
                        double* H_cross, double* b_first, double* b_second);

  // Columns of blocks `first` to before `last` of a symmetric matrix (lower triangle, a last row besides, leading
  // dimension ldf), added to one with leading dimension ldt: block k's rows and columns from at[k] on, ascending, the
  // last row at rhs. run_end[k]: behind the blocks that follow block k in both. Size 3 or 6.
  void (*extend_add)(double* to, int ldt, const double* from, int ldf, const int* at, const int* run_end, int first,
                     int last, int blocks, int rhs, int size);

  // For covariances. Several right-hand sides side by side: x row-major with `stride` columns, a multiple of kLanes.
  //
  // C (rows x columns) += A B', A rows x depth, B columns x depth.
  void (*add_rectangle)(double* c, int ldc, const double* a, int lda, const double* b, int ldb, int rows, int columns,
                        int depth);
  // C = A B'; depth at least one.
  void (*set_rectangle)(double* c, int ldc, const double* a, int lda, const double* b, int ldb, int rows, int columns,
                        int depth);
  // With L = [L_PP; L_RP] (rows x pivots, leading dimension ld): x_P = L_PP^-1 x_P, x_R -= L_RP x_P.
  void (*substitute_forward)(const double* panel, int ld, int rows, int pivots, double* x, int stride);
  // x_P = L_PP^-T (x_P - L_RP' x_R).
  void (*substitute_backward)(const double* panel, int ld, int rows, int pivots, double* x, int stride);
  // Y -= X T, all row-major: Y rows x width, X rows x depth, T depth x width; width a multiple of kLanes.
  void (*subtract_rows)(double* y, int ldy, const double* x, int ldx, const double* t, int ldt, int rows, int depth,
                        int width);
  // Y = Y T for a Y of so many rows, row-major; T depth x stride, depth <= stride, stride kLanes or 2 kLanes.
  void (*transform_rows)(double* y, int stride, const double* t, int rows, int depth);
  // For each of `count` blocks: S (size x size, contiguous) -= (Y M Y' + Y M' Y') / 2, Y size x depth, row-major with
  // `stride` columns, the ones beyond depth zero; M depth x depth, row-major with `stride` columns. Size 3 or 6.
  void (*subtract_congruences)(double* s, const double* y, int stride, const double* m, int count, int size, int depth);
};

inline constexpr int kLanes = 4;
// Columns to make room for.
constexpr int Stride(int columns) { return (columns + kLanes - 1) / kLanes * kLanes; }

// The best for this processor, or those that the environment names, if it has them: TERSE_KERNELS=baseline.
const DenseKernels& Kernels();
// All that this processor runs, for tests.
std::vector<DenseKernels> AvailableKernels();

}  // namespace terse::internal
