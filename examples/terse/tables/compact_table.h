#pragma once
// The numbers behind `terse table compact`: every strategy on one graph.

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "tables/compact_graphs.h"
#include "tables/compact_norms.h"

namespace terse {

struct CompactTableOptions {
  std::optional<double> sample;  // share of the run that the thresholds are chosen from; absent: SelectThresholds's own
  std::uint64_t seed = 1;
  int random_runs = 3;  // of RFPFL and of random maps of the bounded one's size, with the seeds from `seed` on
  bool apfl = false;
  bool norms = false;  // Fig. 6
  // Graphs with more poses: no covariances at every step, and APAL is one batch solution.
  std::size_t most_poses = 20000;
  bool quiet = false;
  std::string folder;  // for the files of every run, GRAPH/STRATEGY in it; none if empty
};

// What a run had grown to at a step, for the figures.
struct GrowthPoint {
  int step = 0;                       // poses seen
  int poses = 0, links = 0;           // kept
  double seconds = 0;                 // since the start, covariances included where they are kept up
  std::int64_t hessian_nonzeros = 0;  // scalars of the lower triangle of H,
  std::int64_t factor_nonzeros = 0;   // and of L
};

struct StrategyResult {
  int poses = 0, links = 0, registrations = 0;
  std::optional<double> seconds_solving, seconds_covariances;
  std::optional<double> Seconds() const;  // both
  std::optional<TrajectoryErrors> errors;
  std::vector<GrowthPoint> growth;
};

// Thresholds as they are printed, of either dimension.
struct ChosenThresholds {
  std::vector<double> range;  // metres, then radians
  double probability = 0, min_loop_gain = 0, min_pose_gain = 0;
  double seconds = 0;  // to choose them
};

struct CompactTableRow {
  std::string graph;
  PaperFigures paper;
  int poses = 0, links = 0;  // offered
  ReferenceKind reference = ReferenceKind::kOptimum;
  ChosenThresholds thresholds;
  std::map<std::string, TrajectoryErrors> recovery;  // Table 1: v0, v1, v2 of FPFL
  StrategyResult apal, fpfl;
  std::optional<StrategyResult> apfl, rfpfl;  // if asked for
  StrategyResult bounded;                     // with thresholds for it
  std::optional<StrategyResult> random;       // of its size, the mean of the errors
  std::vector<NormPoint> norms;

  // Absent without a truth to compare with, or a time.
  std::optional<double> AteRatio(const StrategyResult& of) const;
  std::optional<double> TimeRatio() const;  // APAL / FPFL
};

template <class Pose>
CompactTableRow RunCompactTable(const NamedGraph<Pose>& named, const CompactTableOptions& options);

}  // namespace terse
