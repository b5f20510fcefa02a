#pragma once
// Which initial values a batch optimisation is to start from, found by trying.
//
// A far start ends in a wrong minimum, and no start is always the nearest: composed odometry is far off where the drift
// is, the file's values may be anything, the chordal relaxation suffers where a few loops hold a large graph. So all
// four are made and the best is looked for by a few steps each (Gauss-Newton, damped where they run away), on one
// elimination order. The start of lowest cost goes first. It wins at once if it comes to rest near where it set off and
// no other start is as low; else those that may still win go on in turn, and the lowest cost wins. A graph with a good
// start pays for the relaxation and one evaluation per start; the winner's steps are not lost.

#include <optional>
#include <string>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/initial_values.h"
#include "terse/core/log.h"
#include "terse/core/pose_graph.h"

namespace terse {

// A start that was looked at. Costs are chi2 and what FIXed poses away from their values add.
struct StartTrial {
  InitialValues method = InitialValues::kCompose;
  std::string unavailable;            // why there is no such start, or ""
  std::optional<InitialValues> same;  // the start before it that has the same cost; it is not tried again
  double cost_at_start = 0;
  double cost = 0;     // the lowest found
  int iterations = 0;  // steps tried
};

template <class Pose>
struct StartChoice {
  InitialValues chosen = InitialValues::kCompose;
  std::vector<Pose> T_world_body;  // by pose index; the best found, a few steps from the start
  std::vector<StartTrial> trials;  // file, compose, tree, chordal
  std::vector<int> order;          // of elimination, if there was need of one: for BatchOptions
};

// O(V + E), the relaxation's two sparse factorisations, and one factorisation per step. Throws std::invalid_argument if
// the graph is empty, or not connected and without a value for every pose; NumericalError if chi2 is finite at no
// start.
template <class Pose>
StartChoice<Pose> ChooseStart(const PoseGraph<Pose>& graph, const StartOptions& options = {});

// Where a batch optimisation with these options starts unless it is told: at the best of all, or at composed values
// with a robust kernel, since loops that may be wrong bend a relaxation and odometry does not know them. Then, and if
// the graph is empty, nothing is compared and there are no trials. Throws as ChooseStart and ComputeInitialValues.
template <class Pose>
StartChoice<Pose> StartFor(const PoseGraph<Pose>& graph, const BatchOptions& options);

}  // namespace terse
