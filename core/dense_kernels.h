#pragma once
// Dense kernels on column-major fronts. No Eigen type crosses this boundary.

namespace terse::internal {

// In place on the first `pivots` columns of a lower-trapezoidal panel with `rows` rows and leading dimension `rows`:
// top = L L', bottom = bottom L^-T. Returns the column whose pivot is not positive and finite, or -1.
int FactorPanel(double* panel, int rows, int pivots);

// Lower triangle of U (n x n, leading dimension n) -= S S', S being the last n rows of the factored panel.
void SubtractOuter(double* update, int n, const double* panel, int rows, int pivots);

}  // namespace terse::internal
