#pragma once
// Size against error: compact maps of one graph, from nearly everything kept to next to nothing, beside random ones.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "run/ground_truth.h"
#include "terse/core/log.h"

namespace terse {

struct FrontierOptions {
  std::string ground_truth, thresholds;  // files; both may be empty
  std::optional<double> sample;          // the share of the poses that thresholds are chosen from
  double from = 0.125, to = 8;           // both gains, times those chosen; logarithmic between
  int steps = 7;
  int random_runs = 3;  // draws of every size, with the seeds from `seed` on
  std::uint64_t seed = 1;
  bool quiet = false;
  LogSink log;
};

// A map; of random ones the means over the draws.
struct FrontierPoint {
  double scale = 1;
  double min_loop_gain = 0, min_pose_gain = 0;  // of the map whose size it is
  int poses = 0, links = 0, registrations = 0;
  double seconds = 0;  // of all steps
  PoseError ate;
  double least_ate_m = 0, most_ate_m = 0;  // over the draws; without any the same
};

struct FrontierCurve {
  std::string name;  // fpfl, bounded, and "random, size of ..." with as many poses and links as those keep
  bool is_random = false;
  std::vector<FrontierPoint> points;  // by ascending scale
};

struct Frontier {
  int poses = 0, links = 0;  // offered
  ReferenceKind reference = ReferenceKind::kOptimum;
  std::optional<double> ate_of_all_m;  // of the optimum of the whole graph, where the truth is known
  std::vector<FrontierCurve> curves;
};

// ATE is against the ground truth if a file is given, else against the optimum of the whole graph. Throws what reading
// the files, BatchOptimum and RunCompact throw.
template <class Pose>
Frontier RunFrontier(const PoseGraph<Pose>& graph, const FrontierOptions& options);

}  // namespace terse
