#pragma once
// What an incremental step did.

#include <vector>

#include "terse/core/block_cholesky.h"

namespace terse {

struct StepReport {
  std::vector<FactorId> factor_ids;         // one per added factor
  CholeskyPath path = CholeskyPath::kNone;  // of the added and removed factors
  int fronts_updated = 0;                   // by rank-k update
  int fronts_refactored = 0;                // all iterations
  int variables_refactored = 0;
  bool gate_open = true;
  double gate_value = 0;  // in the gate's unit
  int iterations = 0;     // Gauss-Newton steps taken
  int variables_relinearised = 0;
  int variables_moved = 0;        // whose estimate changed
  double predicted_decrease = 0;  // of chi2 by this step, linearised; kPoint: of the full step if the gate is open
  double actual_decrease = 0;     // of chi2; if report_cost, and always in kPoint
  double gain_nats = 0;           // of the new factors about the poses known before; less the anchor's if it changes
  bool restarted = false;         // the map went over to another, lower minimum (IncrementalOptions::restart)
  int deferred_relinearisations = 0;
  int deferred_fronts = 0;  // subtrees that back-substitution left for later
  double flops = 0;         // factorisation: squared column counts, and 4 k times the entries for rank-k updates
  double solve_flops = 0;   // back-substitution: twice the entries visited
  double seconds = 0;       // of the update
};

}  // namespace terse
