#pragma once
// The numbers behind `terse table sparsify`: graphs made small by every criterion, against chance, and what dropped
// poses cost.

#include <string>
#include <vector>

#include "run/progress.h"
#include "tables/graph_files.h"
#include "terse/compact/sparsify_options.h"

namespace terse {

struct SparsifyTableOptions {
  std::vector<double> percents;             // of the links that are kept
  std::vector<SparsifyCriterion> criteria;  // kRandom: the mean of `draws`
  int draws = 10;
  std::vector<int> sparsities;  // one of so many poses is kept, and all links
  int threads = 1;
  bool quiet = false;
};

// Against the optimum of the whole graph.
struct SparsifyLinksRow {
  double percent = 0;
  SparsifyCriterion criterion = SparsifyCriterion::kPosition;
  int links = 0;              // kept
  double ate = 0;             // metres, after rigid alignment
  double rotation = 0;        // degrees, root mean square
  double log_det_lost = 0;    // nats
  double expected_error = 0;  // metres
  double seconds = 0;         // optima included
};

struct SparsifyPosesRow {
  int sparsity = 0;
  RecoveredFactors recovered = RecoveredFactors::kTree;
  int poses = 0;          // kept: more than asked for where others may not go
  double divergence = 0;  // nats, from the exact marginal
  double seconds = 0;     // to drop them
};

struct SparsifyTableGraph {
  GraphPath is;
  std::string failure;  // why rows are missing
  int dimension = 0, poses = 0, links = 0;
  double expected_error = 0;  // metres, of the whole graph
  std::vector<SparsifyLinksRow> link_rows;
  std::vector<SparsifyPosesRow> pose_rows;
};

// Over the cells, graphs times percents, that keep some links and not all.
struct SparsifySummary {
  int cells = 0;
  int position_best = 0;      // ATE by position at most the smallest of connectivity and random
  double position_ratio = 0;  // ATE by position over that, the geometric mean
  int information_best = 0;   // log-determinant loss by information is the smallest of all
};

long CountRuns(const SparsifyTableOptions& options);  // on one graph
// `done`: runs so far, of which Progress is told.
SparsifyTableGraph RunSparsifyTable(const GraphPath& graph, const SparsifyTableOptions& options, Progress& progress,
                                    long& done);
// No cells where one of the criteria it compares is missing.
SparsifySummary Summarise(const std::vector<SparsifyTableGraph>& graphs);

}  // namespace terse
