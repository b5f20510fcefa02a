#include "terse/compact/decision.h"

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

}  // namespace terse
