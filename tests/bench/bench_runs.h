#pragma once
// What is measured on a graph. Every result is JSON; report.h turns it into tables.

#include <nlohmann/json.hpp>

#include "terse/core/initial_values.h"
#include "terse/core/pose_graph.h"

namespace terse::bench {

// One pose per step with all its edges, composed initial values, the full estimate after every step (in the time).
// At every `interval`-th step, outside the time: chi2 against the batch optimum from there, and what CHOLMOD takes to
// analyse, factorise and solve the whole system at the same linearisation points, building the matrix not counted.
// CHOLMOD's total is the sampled times multiplied by the interval.
template <class Pose>
nlohmann::json RunIncremental(const PoseGraph<Pose>& graph, int interval);

// Time from the same start until chi2 is within 1e-6 of the optimum, ours and that of Ceres: the best of `repeats`.
template <class Pose>
nlohmann::json RunBatch(const PoseGraph<Pose>& graph, InitialValues start, int repeats);

// A generated Manhattan world fed pose by pose: median and worst step by decade, and memory. Links that reach back
// further than `longest_link` steps are left out. The estimate of the newest pose is read after every step, not all.
nlohmann::json RunGrowth(long poses, long longest_link);

}  // namespace terse::bench
