#pragma once
// Where the commands start a batch optimisation.

#include <nlohmann/json.hpp>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/initial_values.h"
#include "terse/core/start_values.h"

namespace terse {

// The initial values, and under "initial" in `stats` which they are; for kAuto, which is composed values with a robust
// kernel, all that were compared too. `options` gets the elimination order, if one was found on the way.
template <class Pose>
std::vector<Pose> StartValues(const PoseGraph<Pose>& graph, InitialValues method, BatchOptions& options,
                              nlohmann::ordered_json& stats);

// Puts under "initial" in `stats` where an optimisation started.
void DescribeStart(InitialValues chosen, bool is_automatic, const std::vector<StartTrial>& trials,
                   nlohmann::ordered_json& stats);

}  // namespace terse
