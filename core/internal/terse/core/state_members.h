#pragma once
// How state_file.h stores the types of this library: for the .cpp of a class that holds an IncrementalSolver. Those
// that hold less include less (graph_members.h, option_members.h), so that fewer are compiled again when the solver
// changes.

#include "terse/core/graph_members.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/option_members.h"

namespace terse {

template <class Archive>
void Serialize(Archive& archive, PhaseSeconds& seconds) {
  auto& [order, linearise, factor, solve] = seconds;
  archive(order, linearise, factor, solve);
}

// Those of the classes are compiled in the library.
#define TERSE_EXTERN_STATE(Archive, Pose) extern template void IncrementalSolver<Pose>::Serialize<Archive>(Archive&);
TERSE_EXTERN_STATE(StateWriter, SE2)
TERSE_EXTERN_STATE(StateReader, SE2)
TERSE_EXTERN_STATE(StateWriter, SE3)
TERSE_EXTERN_STATE(StateReader, SE3)
#undef TERSE_EXTERN_STATE

}  // namespace terse
