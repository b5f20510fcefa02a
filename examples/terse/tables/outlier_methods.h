#pragma once
// The methods that `terse table outliers` compares: what makes a map of a graph that may hold wrong loops.

#include <optional>
#include <string>
#include <vector>

#include "tables/outlier_scene.h"
#include "terse/compact/compact_options.h"
#include "terse/core/robust.h"

namespace terse {

struct OutlierMethod {
  // kIncremental: pose by pose; the map is that after the last step, unless `finish`. kCompact: as `terse compact` does
  // it, information calibrated and thresholds chosen from the very graph. kChance, kOdometry: what a method has to
  // beat, the optimum with each loop kept by chance, as probably as one of them is true, or with none; of a clean graph
  // with all.
  enum class Mode { kBatch, kIncremental, kCompact, kChance, kOdometry };
  std::string name;
  Mode mode = Mode::kBatch;
  RobustKernel kernel = RobustKernel::kNone;
  bool finish = false;
  std::optional<Strategy> strategy = {};  // kCompact; absent: the default's
};

// batch-KERNEL, incremental-KERNEL for every kernel, incremental-gnc-finish, compact and variants of it, chance and
// odometry.
const std::vector<OutlierMethod>& OutlierMethods();
// Throws std::invalid_argument if there is none of this name.
const OutlierMethod& OutlierMethodOf(const std::string& name);

struct OutlierMap {
  LoopCounts loops;
  double ate = 0;                    // metres, to the scene's reference
  double seconds = 0;                // all of it
  std::vector<double> step_seconds;  // one per pose; empty but for kIncremental and kCompact
};

// Compact maps believe a loop that they accepted and, where it still is a factor or a part of one, weigh with at least
// one half; of what went into other factors as poses retired, all is believed. On one thread. Throws what the methods
// throw, std::runtime_error if it takes longer than `most_seconds` (0: no limit).
template <class Pose>
OutlierMap RunOutlierMethod(const OutlierMethod& method, const OutlierScene<Pose>& scene,
                            const Contaminated<Pose>& with, double most_seconds = 0);

}  // namespace terse
