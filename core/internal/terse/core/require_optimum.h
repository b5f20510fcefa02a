#pragma once

#include "terse/core/batch_solver.h"
#include "terse/core/error.h"

namespace terse {

// Throws NumericalError with the result's message if it has no values to go on with: not positive definite, diverged.
template <class Pose>
void RequireOptimum(const BatchResult<Pose>& result) {
  if (result.termination != Termination::kNotPositiveDefinite && result.termination != Termination::kDiverged) return;
  throw NumericalError(result.message);
}

// Whether it has a Cholesky factor to look into.
template <class Pose>
bool HasFactor(const BatchResult<Pose>& solved) {
  return solved.termination != Termination::kNotPositiveDefinite && solved.cholesky.Variables() > 0;
}

}  // namespace terse
