#pragma once
// What is measured on a graph. Every result is JSON; report.h turns it into tables.

#include <nlohmann/json.hpp>

#include "terse/core/generate.h"
#include "terse/core/initial_values.h"
#include "terse/core/pose_graph.h"

namespace terse::bench {

// One pose per step with all its edges, composed initial values, the full estimate after every step (in the time).
// At every `interval`-th step, outside the time: chi2 against the batch optimum from there, and what CHOLMOD takes to
// analyse, factorise and solve the whole system at the same linearisation points, building the matrix not counted.
// CHOLMOD's total is the sampled times multiplied by the interval.
template <class Pose>
nlohmann::json RunIncremental(const PoseGraph<Pose>& graph, int interval);

// What one core of this machine can do: the dense product's GFLOP/s on operands in cache, GB/s read from memory.
nlohmann::json MeasureRoof();

// Time from the same start until chi2 is within 1e-6 of the optimum, ours and that of Ceres: the best of `repeats`.
template <class Pose>
nlohmann::json RunBatch(const PoseGraph<Pose>& graph, InitialValues start, int repeats);

// A generated Manhattan world fed pose by pose: median and worst step by decade, and memory. Links that reach back
// further than `longest_link` steps are left out. The estimate of the newest pose is read after every step, not all.
nlohmann::json RunGrowth(long poses, long longest_link);

// Covariances kept at every step of an incremental run: the seconds of IncrementalMarginals::Update, of reading all
// diagonal blocks and of the whole newest column, beside those of the solver's updates. At every `interval`-th step the
// same by recursion, whose total is the sampled times scaled up to all steps, and outside the time the error of
// twenty diagonal blocks and of the newest column (covariance_oracle.h).
template <class Pose>
nlohmann::json RunCovarianceKept(const PoseGraph<Pose>& graph, int interval);

// The newest block and its block column to the `candidates` poses nearest to it as estimated, asked for at every step
// and nothing kept.
template <class Pose>
nlohmann::json RunCovarianceNewest(const PoseGraph<Pose>& graph, int candidates);

// All diagonal blocks at the batch optimum beside one numeric factorisation, the fastest of ten each; and by
// Ceres, once, if it ends within `ceres_limit` seconds of processor time.
template <class Pose>
nlohmann::json RunCovarianceBatch(const PoseGraph<Pose>& graph, InitialValues start, int ceres_limit);

// A generated world fed pose by pose; joint covariances of 2, 10 and 50 poses at equal distances along the path, the
// newest among them, right after loop closures in the last fifth of the run.
nlohmann::json RunCovarianceJoint(Scene scene, long poses);

}  // namespace terse::bench
