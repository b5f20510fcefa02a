#pragma once
// Weights of a batch result by id.

#include "terse/core/batch_solver.h"

namespace terse::testing {

template <class Pose>
double WeightOf(const PoseGraph<Pose>& graph, FactorId id, const BatchResult<Pose>& result) {
  std::size_t k = 0;
  for (const auto& node : graph.Factors()) {
    if (node.id == id) break;
    ++k;
  }
  return result.weights.at(k);
}

}  // namespace terse::testing
