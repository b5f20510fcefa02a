#pragma once
// What solve and compact write besides the graph: counts, statistics, trajectories.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/pose_graph.h"
#include "terse/core/trajectory.h"

namespace terse {

struct ReplayStep;

struct EdgeCounts {
  long edges = 0;
  long loop_edges = 0;  // between poses that are not neighbours in the order of ids
  long duplicates = 0;  // edges beyond the first between the same two poses
  long scalars = 0;     // that all factors measure
};
template <class Pose>
EdgeCounts CountEdges(const PoseGraph<Pose>& graph);

// The numbers of stats.json.
struct Stats {
  std::size_t poses = 0;
  EdgeCounts counts;
  double chi2 = 0, normalized_chi2 = 0, log_determinant = 0;
  int iterations = 0;
  std::string termination;
  bool converged = false;
  int threads = 1;                   // at most
  std::vector<double> step_seconds;  // one per step
  double seconds_total = 0, seconds_read = 0, seconds_covariance = 0;
  PhaseSeconds phases;
  nlohmann::ordered_json more;  // further keys of the subcommand
};
nlohmann::ordered_json ToJson(const Stats& stats);

// Comma-separated values, a row per step of an incremental run: docs/outputs.md. `poses` and `factors`: in the graph by
// then.
void WriteStepsHeader(std::ostream& out);
// `model`: the step's work as Arablouei 2026 counts it, where that was asked for.
struct ModelFlops {
  double update = 0, solve = 0;
};
void WriteStepsRow(const ReplayStep& step, std::size_t poses, std::size_t factors, const ModelFlops& model,
                   std::ostream& out);

// Of this process, so far.
double PeakRssMegabytes();

// A clock for one phase.
double SecondsNow();

// KITTI if the path ends in .kitti or .txt, else TUM.
void WriteTrajectory(const Trajectory& trajectory, const std::string& path);
// The cause if the ending of a path tells neither, else empty. No ending (a pipe, standard output) is TUM.
std::string FindTrajectoryPathDefect(const std::string& path);

}  // namespace terse
