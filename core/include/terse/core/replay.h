#pragma once
// Feeds a stored graph to an incremental solver as it would have come in online (arrival.h).

#include <functional>

#include "terse/core/arrival.h"
#include "terse/core/incremental_solver.h"

namespace terse {

struct ReplayOptions {
  ArrivalUnit every = ArrivalUnit::kPose;
  // New poses start at the values in the graph. Otherwise they are composed, and only the first pose and fixed ones
  // have the graph's value.
  bool stored_values = false;
};

struct ReplayStep {
  int index = 0, steps = 0;
  StepReport report;
};

// Calls `after_step` when the solver has taken a step in; it returns false to stop. Throws std::invalid_argument if the
// graph is not connected, or lacks a value where they are asked for, and what IncrementalSolver::Update throws.
template <class Pose>
void Replay(const PoseGraph<Pose>& graph, const ReplayOptions& options, IncrementalSolver<Pose>& solver,
            const std::function<bool(const ReplayStep&)>& after_step = nullptr);

// Brings the poses and weights of a result on a graph that was replayed, `arrived`, into the order of the graph.
template <class Pose>
void OrderAsIn(const PoseGraph<Pose>& graph, ArrivalUnit every, const PoseGraph<Pose>& arrived,
               BatchResult<Pose>& result);

}  // namespace terse
