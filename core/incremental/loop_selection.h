#pragma once
// Loops told apart for a batch solve, by the judgement of the incremental solver (loop_judge.h): a loop that comes in
// is compared with what the map knows by then, which a graduation over all loops at once does not have.

#include <optional>
#include <vector>

#include "terse/core/batch_solver.h"

namespace terse::internal {

template <class Pose>
struct LoopSelection {
  std::vector<Pose> T_world_body;        // the optimum with the loops that are believed, by pose index
  std::vector<FactorId> robust_factors;  // the loops, and odometry that slipped
  double width;                          // of the kernel, in the end
};

// By a replay in order of arrival, composed from the first pose on; nothing where that is not possible. is_stopped: the
// caller's progress said so.
template <class Pose>
std::optional<LoopSelection<Pose>> SolveByReplay(const PoseGraph<Pose>& graph, const BatchOptions& options,
                                                 bool& is_stopped);

}  // namespace terse::internal
