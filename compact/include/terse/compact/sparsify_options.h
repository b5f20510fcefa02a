#pragma once
// What Sparsify (sparsify.h) is asked for.

#include <cstdint>
#include <functional>
#include <optional>
#include <stdexcept>
#include <string>

namespace terse {

// What makes a link worth keeping, each linear at the optimum of the whole graph.
enum class SparsifyCriterion {
  // How much it lowers the expected squared error of all positions after the best rigid alignment (A-optimality).
  kPosition,
  // How much it raises the log-determinant of the information (D-optimality).
  kInformation,
  // The algebraic connectivity of the graph, weighted by the information about rotations (MAC: Doherty, Rosen, Leonard,
  // 2022). For comparison: it knows nothing of geometry.
  kConnectivity,
  // As many drawn at random. For comparison.
  kRandom,
};

// Edges that are kept in any case; all others are the links that the budget is for.
enum class FixedEdges {
  kOdometry,  // between poses that follow each other in order of arrival
  kTree,      // a spanning tree of the edges that hold best
  kNone,      // as many as a spanning tree has, but whichever are worth it
};

// What replaces the factors of a pose that goes: relative poses with full information between its neighbours.
enum class RecoveredFactors {
  kTree,      // along a spanning tree, and where neighbours are joined already
  kSubgraph,  // about three for each neighbour
  kDense,     // between all of them
};

// So many, or such a share of what there is.
struct SparsifyBudget {
  double value = 1;
  bool is_share = true;
  // Rounded to the nearest whole number, of `total` at most.
  int Of(int total) const;
};

struct SparsifyOptions {
  // Links and poses to keep. Absent: all.
  std::optional<SparsifyBudget> links, poses;
  // As few links as leave the expected position error within this factor of the whole graph's; at least 1. Instead of
  // `links`.
  std::optional<double> budget_error;
  SparsifyCriterion criterion = SparsifyCriterion::kPosition;
  FixedEdges fixed = FixedEdges::kOdometry;
  RecoveredFactors recovered = RecoveredFactors::kSubgraph;
  // What is recovered never says more than the exact marginal.
  bool conservative = false;
  // Every measurement that is kept is replaced by what the optimum of the whole graph says in its place, so that the
  // sparsified graph has the same optimum; its information stays as it was.
  bool recentre = false;
  std::uint64_t seed = 1;  // of kRandom, and of the rounding of kConnectivity
  int threads = 1;         // the result is the same for any number
  // Told what is being done and which share of that is done, 0 to 1. False: give up (StoppedError).
  std::function<bool(const std::string& task, double share)> progress;
};

// SparsifyOptions::progress said false.
class StoppedError : public std::runtime_error {
 public:
  StoppedError() : std::runtime_error("stopped") {}
};

}  // namespace terse
