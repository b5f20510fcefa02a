#pragma once
// Gauss-Newton over several processes: every rank linearises its share of the graph, PETSc solves each step (MUMPS'
// Cholesky factor unless its options say otherwise), a line search keeps chi2 falling.
//
//     PetscSession session({});
//     const auto share = ReadShare<SE2>(path, RankOf(MPI_COMM_WORLD), RankCount(MPI_COMM_WORLD));
//     const auto solved = SolveDistributed(MPI_COMM_WORLD, share, {DistributedChordalValues(MPI_COMM_WORLD, share)});
//
// Minimises what SolveBatch does (batch_solver.h): chi2, with the gauge of gauge.h. All functions are collective, and
// all ranks get the same result.

#include <functional>
#include <string>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/core/start_values.h"
#include "terse/distributed/graph_share.h"
#include "terse/distributed/ranks.h"

namespace terse {

// MPI and PETSc from here to the end of the object; one in a process. `options`: PETSc's own, as "-ksp_type", "cg".
class PetscSession {
 public:
  explicit PetscSession(const std::vector<std::string>& options);
  ~PetscSession();
  PetscSession(const PetscSession&) = delete;
  PetscSession& operator=(const PetscSession&) = delete;
  // Options that nothing has asked for so far, with their dash: misspelt, most likely. Not collective.
  std::vector<std::string> UnusedOptions() const;
};

struct DistributedOptions {
  int max_iterations = 200;  // from one start
  // Converged when a step lowers chi2, or is predicted to, by less than this share of it.
  double relative_tolerance = 1e-11;
  std::function<void(int iteration, double chi2)> progress;  // on every rank, after every step of any start
  std::vector<int> covariances_of;                           // indices of poses, whose marginals are solved for
};

template <class Pose>
struct DistributedResult {
  Termination termination = Termination::kMaxIterations;
  std::vector<Pose> T_world_body;  // of the whole graph, by pose index
  int iterations = 0;
  double chi2 = 0;                                   // without the priors of FIXed poses
  int start = 0;                                     // the index of the start it came from
  std::vector<StartTrial> trials;                    // by start; methods are not set
  PhaseSeconds seconds;                              // of this rank; the order is part of the first factor
  std::vector<typename Pose::Jacobian> covariances;  // of DistributedOptions::covariances_of, at T_world_body
  bool Converged() const { return termination == Termination::kConverged; }
};

// Rank 0's values, on all ranks; as many everywhere before.
template <class Pose>
void BroadcastPoses(MPI_Comm ranks, std::vector<Pose>& T_world_body);

// From the best of the starts, each the values of all poses by pose index. Of several the one of lowest cost takes
// three steps; unless it rests near where it set off and no other is as low, the others do too, and the lowest goes on.
// Throws RankError on all ranks: kNumerical if the system is singular, the linear solver fails or chi2 is finite at no
// start.
template <class Pose>
DistributedResult<Pose> SolveDistributed(MPI_Comm ranks, const GraphShare<Pose>& share,
                                         std::vector<std::vector<Pose>> starts, const DistributedOptions& options = {});

}  // namespace terse
