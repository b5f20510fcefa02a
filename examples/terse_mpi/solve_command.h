#pragma once
// `terse-mpi solve`: as `terse solve`, over the ranks of an MPI run.

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "terse/distributed/distributed_solver.h"

namespace terse {

void AddDistributedSolve(CLI::App& app, const PetscSession& session);

}  // namespace terse
