#include "terse/compact/decision.h"

#include <algorithm>

#include "compact_pose_slam_parts.h"
#include "terse/compact/words.h"

namespace terse {

const char* Name(Strategy strategy) { return WordOf(strategy); }

const char* Name(PoseVerdict verdict) {
  switch (verdict) {
    case PoseVerdict::kFirst: return "first";
    case PoseVerdict::kAllKept: return "all_kept";
    case PoseVerdict::kLoopClosed: return "loop_closed";
    case PoseVerdict::kPrior: return "prior";
    case PoseVerdict::kNothingInRange: return "nothing_in_range";
    case PoseVerdict::kInformative: return "informative";
    case PoseVerdict::kRedundant: return "redundant";
    case PoseVerdict::kGiven: return "drawn";
    case PoseVerdict::kAnchored: return "anchored";
  }
  return "unknown";
}

// Of updates of one step; what is left to do is that of the last one.
void Accumulate(const StepReport& update, std::optional<StepReport>& sum) {
  if (!sum) {
    sum = update;
    return;
  }
  StepReport& s = *sum;
  s.factor_ids.insert(s.factor_ids.end(), update.factor_ids.begin(), update.factor_ids.end());
  s.path = std::max(s.path, update.path);
  s.fronts_updated += update.fronts_updated;
  s.fronts_refactored += update.fronts_refactored;
  s.variables_refactored += update.variables_refactored;
  s.gate_open = s.gate_open || update.gate_open;
  s.gate_value = std::max(s.gate_value, update.gate_value);
  s.iterations += update.iterations;
  s.variables_relinearised += update.variables_relinearised;
  s.variables_moved += update.variables_moved;
  s.predicted_decrease += update.predicted_decrease;
  s.actual_decrease += update.actual_decrease;
  s.gain_nats += update.gain_nats;
  s.restarted = s.restarted || update.restarted;
  s.deferred_relinearisations = update.deferred_relinearisations;
  s.deferred_fronts = update.deferred_fronts;
  s.flops += update.flops;
  s.solve_flops += update.solve_flops;
  s.seconds += update.seconds;
}

}  // namespace terse
