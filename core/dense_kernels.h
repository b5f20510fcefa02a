#pragma once
// Dense kernels on column-major fronts, compiled for several instruction sets; the best one that the processor runs
// is chosen at start. No Eigen type crosses this boundary. Only lower triangles are meaningful.

#include <vector>

namespace terse::internal {

struct DenseKernels {
  const char* name;
  // In place on the first `pivots` columns of a lower-trapezoidal panel with `rows` rows and leading dimension
  // `rows`: top = L L', bottom = bottom L^-T. Returns the column whose pivot is not positive and finite, or -1.
  int (*factor_panel)(double* panel, int rows, int pivots);
  // U (n x n, leading dimension n) -= S S', S being the last n rows of the factored panel.
  void (*subtract_outer)(double* update, int n, const double* panel, int rows, int pivots);
};

// The best for this processor.
const DenseKernels& Kernels();
// All that this processor runs, for tests.
std::vector<DenseKernels> AvailableKernels();

}  // namespace terse::internal
