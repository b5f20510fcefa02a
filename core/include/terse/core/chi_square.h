#pragma once
// The chi-square distribution, which squared Mahalanobis distances have.

namespace terse {

// x with P(chi-square of `dof` degrees <= x) = probability, to rounding; O(dof). Throws std::invalid_argument unless
// 0 <= probability < 1 and dof >= 1.
double ChiSquareQuantile(double probability, int dof);

}  // namespace terse
