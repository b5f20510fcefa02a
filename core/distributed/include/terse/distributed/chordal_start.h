#pragma once
// InitialValues::kChordal (initial_values.h) by all ranks, none of which holds the whole graph.

#include <vector>

#include <mpi.h>

#include "terse/distributed/graph_share.h"

namespace terse {

// By pose index, on every rank the same to the last bit. PETSc's options choose the solver, as in SolveDistributed.
// Throws RankError on all ranks (kNumerical) if a system is singular or the linear solver fails. Collective.
template <class Pose>
std::vector<Pose> DistributedChordalValues(MPI_Comm ranks, const GraphShare<Pose>& share);

}  // namespace terse
