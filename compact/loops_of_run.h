#pragma once

#include <algorithm>
#include <set>
#include <utility>
#include <vector>

#include "terse/compact/decision.h"
#include "terse/core/robust.h"

namespace terse {

// Loops of the graph between poses that a map had candidates of some kind for, is(Candidate), ascending.
template <class Pose, class Is>
std::vector<FactorId> LoopsOf(const std::vector<Decision>& decisions, const PoseGraph<Pose>& graph, const Is& is) {
  std::set<std::pair<PoseId, PoseId>> joined;
  for (const Decision& decision : decisions) {
    for (const Candidate& link : decision.candidates) {
      if (is(link)) joined.insert(std::minmax(decision.id, link.carried_from.value_or(link.id)));
    }
  }
  if (joined.empty()) return {};
  std::vector<FactorId> loops = LoopFactors(graph);
  const auto is_other = [&](FactorId id) {
    const FactorPoses ends = PosesOf(graph.FindFactor(id)->factor);
    return joined.count(std::minmax(ends.first, ends.second)) == 0;
  };
  loops.erase(std::remove_if(loops.begin(), loops.end(), is_other), loops.end());
  return loops;
}

}  // namespace terse
