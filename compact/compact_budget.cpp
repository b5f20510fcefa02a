// Which budgets make sense.

#include <cmath>

#include "terse/compact/compact_options.h"

namespace terse {

std::string FindDefect(const CompactBudget& budget, Strategy strategy) {
  const auto& [keep_poses, keep_links, poses_per_area, error] = budget;
  for (const std::optional<double>& share : {keep_poses, keep_links}) {
    if (share && !(*share > 0 && *share <= 1)) return "a budget is a share above 0 and at most 1";
  }
  if (poses_per_area && !(*poses_per_area > 0 && std::isfinite(*poses_per_area)))
    return "poses per area must be positive and finite";
  if (error && !(*error > 1 && std::isfinite(*error)))
    return "the growth of the error that is asked for must be above 1 and finite";
  if (keep_poses && poses_per_area)
    return "a share of the poses and poses per area contradict each other: ask for one of them";
  if (error && (keep_poses || keep_links || poses_per_area))
    return "a growth of the error and a budget of poses or links contradict each other: ask for one of them";
  if ((poses_per_area || error) && (strategy == Strategy::kApal || strategy == Strategy::kApfl)) {
    return std::string(poses_per_area ? "poses per area" : "a growth of the error") +
           " cannot be asked for of a strategy that keeps all poses";
  }
  return "";
}

}  // namespace terse
