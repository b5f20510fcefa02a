#pragma once
// In which order the poses of a graph are eliminated: what decides how full its Cholesky factor is.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

// Pose indices, first to last: minimum degree (CCOLAMD), or nested dissection (SCOTCH) where that takes fewer
// operations. The same for the same graph. For those who factor a graph several times; a factorisation that is given
// none looks for one itself.
template <class Pose>
std::vector<int> EliminationOrder(const PoseGraph<Pose>& graph);

}  // namespace terse
