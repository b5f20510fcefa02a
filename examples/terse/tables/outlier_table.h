#pragma once
// The numbers behind `terse table outliers`: the protocol of the literature on SLAM with wrong loops. Every graph with
// a growing share of wrong loops, several seeds, through every method; each run is compared with the same method's run
// on the clean graph.

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "run/progress.h"
#include "tables/graph_files.h"
#include "tables/outlier_methods.h"
#include "terse/covariance/information_scale.h"

namespace terse {

struct OutlierTableOptions {
  std::vector<double> percents;  // of all loops that are wrong ones, in [0, 100): 50 is as many wrong as true
  std::vector<OutlierKind> kinds;
  std::vector<std::string> methods;
  int seeds = 10;
  std::uint64_t first_seed = 1;
  int threads = 1;  // runs at a time; but for times the results do not depend on it
  double most_seconds = 0;
  bool quiet = false;
};

struct StepTimes {
  double median_ms = 0, p99_ms = 0, worst_ms = 0;
};
// Of at least one step. The smallest time that 99 % of the steps do not exceed.
StepTimes TimesOf(std::vector<double> step_seconds);

struct OutlierRun {
  std::optional<OutlierKind> kind;  // absent: the clean graph, percent and seed 0
  double percent = 0;
  std::uint64_t seed = 0;
  std::string method;
  std::string failure;  // what was thrown; there is no map then, and all but the time is 0
  LoopCounts loops;
  double ate = 0;                  // metres, to the reference
  double seconds = 0;              // all of it
  std::optional<StepTimes> steps;  // of methods that go pose by pose, one run at a time
  // What Judge makes of it.
  double precision = 0, recall = 0;
  double error = 0;  // metres
  std::optional<double> ratio;
  bool success = false;
};

// `sigma`: the reference's own error, metres.
//   precision  true loops among those kept; 1 if none is kept
//   recall     kept among the true loops; of compact maps, that do not keep them all, kept over what `clean` keeps
//   error      sqrt(ATE^2 + sigma^2)
//   ratio      to the error of `clean`, the same method's run without wrong loops; absent if that failed or has none
//   success    within 1.2 times that, and precision above 0.95
void Judge(const OutlierRun& clean, double sigma, OutlierRun& run);

// Runs of one method that differ in the seed. Means over those that did not fail; medians and worst values count
// failed ones as infinite.
struct OutlierRow {
  std::optional<OutlierKind> kind;
  double percent = 0;
  std::string method;
  int runs = 0, failed = 0, successes = 0;
  std::string failure;                       // of the first that failed
  double precision = 0, recall = 0;          // means
  double median_ate = 0, worst_ate = 0;      // metres
  double median_ratio = 0, worst_ratio = 0;  // of the error
  std::optional<StepTimes> steps;            // medians of median and p99, the worst of all
  double seconds = 0;                        // sum
};
// Of at least one run.
OutlierRow Summarise(const std::vector<OutlierRun>& runs);

struct OutlierGraph {
  GraphPath is;
  std::string failure;  // why the graph has no runs
  int dimension = 0, poses = 0, loops = 0;
  ReferenceKind reference = ReferenceKind::kOptimum;
  double sigma = 0;              // of the optimum if that is the reference, metres
  InformationScale scale;        // of the information
  std::vector<OutlierRun> runs;  // row by row
  std::vector<OutlierRow> rows;  // clean ones first, then kind by kind, method by method, percent by percent
};

// Runs per graph.
long CountRuns(const OutlierTableOptions& options);
// Where runs come from and go to that are to outlast this one; either may be empty. `add` is called by one thread at a
// time, `find` by several.
struct OutlierRunStore {
  std::function<const OutlierRun*(const OutlierGraph&, const OutlierRun&)> find;  // the same one, or nullptr
  std::function<void(const OutlierGraph&, const OutlierRun&)> add;
};

// Reads the graph, calibrates its information (information_scale.h; implausible one even if it differs from edge to
// edge), finds the reference and runs all methods. What throws on the way is a failure of the graph or of the run; what
// `store` throws passes through. `folder`: for FindReference. Counts its runs in `done`.
OutlierGraph RunOutlierTable(const GraphPath& graph, const std::string& folder, const OutlierTableOptions& options,
                             const OutlierRunStore& store, Progress& progress, long& done);

// Over all graphs of a dimension.
struct OutlierSummary {
  int dimension = 0;
  std::optional<OutlierKind> kind;
  std::string method;
  int runs_to_half = 0, successes_to_half = 0;  // above 0 and up to 50 %
  int runs_at_90 = 0, successes_at_90 = 0;
  struct Ratio {
    double percent = 0, median = 0, worst = 0;
  };
  std::vector<Ratio> ratios;  // of the error, runs that failed are infinite; ascending percent
};
// By dimension, kind and method, in the order in which they come.
std::vector<OutlierSummary> SummariseAll(const std::vector<OutlierGraph>& graphs);

}  // namespace terse
