#pragma once
// Batch optimisation of a pose graph: Gauss-Newton and Levenberg-Marquardt on the block multifrontal factor.
//
//     const auto solved = SolveBatch(graph);
//     WriteG2o(graph.WithPoses(solved.T_world_body), "solved.g2o");
//
// Minimises chi2(T) = sum r' Omega r over all poses, T <- T.Retract(d), from the best of several starts or from given
// initial values; with a robust kernel (robust.h) the loops' rho(r' Omega r) in place of theirs. The gauge is fixed as
// gauge.h describes. Throws std::invalid_argument for misuse (sizes, an empty graph); everything numerical is reported
// in the result.

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/core/log.h"
#include "terse/core/observability.h"
#include "terse/core/pose_graph.h"
#include "terse/core/robust.h"

namespace terse {

enum class Method {
  kGaussNewton,         // full steps; stops if chi2 rises
  kLevenbergMarquardt,  // full steps while they lower chi2, damped where they do not
};

struct BatchOptions {
  Method method = Method::kLevenbergMarquardt;
  int max_iterations = 200;  // with RobustKernel::kGnc those of the graduation come on top
  // Converged when a step lowers the cost, or is predicted to, by less than this share of it.
  double relative_tolerance = 1e-11;
  int threads = 1;  // at most; the result is the same to the last bit for any number
  // Called after every iteration with its number and chi2. Return false to stop.
  std::function<bool(int iteration, double chi2)> progress;
  // Told the share of a factorisation's work that is done, from any thread, from one at a time: what falls begins anew.
  std::function<void(double share)> factor_progress;
  // Of elimination, pose indices (elimination_order.h); empty: one is looked for. With a robust kernel it always is,
  // for the loops that have weight.
  std::vector<int> order;
  // The factor goes to a file if it takes more than so many bytes (BlockCholesky::DropUpdateMatrices); FileError if
  // there is no room. 0: than half of the memory that is free when it is made.
  std::uint64_t most_factor_bytes = 0;
  RobustOptions robust;
  // The relative factors that the kernel is for; absent: LoopFactors. The others must hold every pose.
  std::optional<std::vector<FactorId>> robust_factors;
  // kGnc: false if the initial values are good and only the loops that they contradict are to be left out. Else the
  // loops are told apart by a replay in order of arrival, as IncrementalSolver does it, whatever the initial values:
  // where many have no other that agrees with them over a short way, the others come first. Where a replay is not
  // possible, or robust_factors says which they are, by graduation from the initial values. Up to 500 loops by both,
  // the lower cost wins.
  bool graduate = true;
  LogSink log;  // log.h
};

// kStalled: no step lowers chi2 any more although the gradient has not vanished, as at a jump of the angle residual.
enum class Termination { kConverged, kMaxIterations, kStalled, kDiverged, kNotPositiveDefinite, kStopped };
const char* Name(Termination termination);

// Seconds spent; the parts do not add up to the whole.
struct PhaseSeconds {
  double order = 0, linearise = 0, factor = 0, solve = 0;
};

template <class Pose>
struct BatchResult {
  Termination termination = Termination::kMaxIterations;
  std::string message;             // what happened, for people
  std::vector<Pose> T_world_body;  // by pose index; the best found
  int iterations = 0;
  double chi2 = 0;           // at T_world_body, without gauge terms; no kernel, no weights
  double robust_cost = 0;    // the same with the kernel; chi2 if there is none
  double gradient_norm = 0;  // largest entry of A'r there
  double log_determinant = 0;
  PhaseSeconds seconds;
  // The factor at T_world_body (variable = pose index), for covariances; empty if not positive definite.
  BlockCholesky<Pose::kDof> cholesky;
  std::vector<FreeMotion> free_motions;  // what no measurement sees, if not positive definite
  double robust_width = 0;               // with a robust kernel: c, as it was in the end
  std::vector<double> weights;           // with a robust kernel: by position in the graph's factors; those of `factor`
  bool Converged() const { return termination == Termination::kConverged; }
};

// From a start that is found by trying, as the command does (StartFor, start_values.h): the file's values, composed
// odometry, a spanning tree or a chordal relaxation; with a robust kernel composed odometry. Throws
// std::invalid_argument besides if the graph is not connected and a pose has no value.
template <class Pose>
BatchResult<Pose> SolveBatch(const PoseGraph<Pose>& graph, const BatchOptions& options = {});
// From these values, by pose index (initial_values.h makes some).
template <class Pose>
BatchResult<Pose> SolveBatch(const PoseGraph<Pose>& graph, const std::vector<Pose>& initial,
                             const BatchOptions& options = {});

// The undamped factor at given values (variable = pose index). Throws UnobservableError if the system is singular,
// NumericalError if it is not finite.
template <class Pose>
BlockCholesky<Pose::kDof> CholeskyAt(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body);

}  // namespace terse
