#pragma once
// A stored graph pose by pose (arrival.h).

#include <algorithm>
#include <cstddef>
#include <variant>
#include <vector>

#include "terse/core/arrival.h"

namespace terse::internal {

// A pose of a stored graph as it would have come in online.
template <class Pose>
struct Arrival {
  int pose = 0;
  std::vector<int> factors;                     // those that arrive with it, in order
  std::vector<RelativePoseFactor<Pose>> edges;  // the relative ones of them
};

template <class Pose>
std::vector<Arrival<Pose>> Arrivals(const PoseGraph<Pose>& graph) {
  std::vector<Arrival<Pose>> out;
  std::vector<std::size_t> position(graph.Poses().size());
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int pose : step.poses) {
      position[static_cast<std::size_t>(pose)] = out.size();
      out.push_back({pose, {}, {}});
    }
    for (const int f : step.factors) {
      const auto& factor = graph.Factors()[static_cast<std::size_t>(f)].factor;
      const FactorPoses ends = PosesOf(factor);
      const auto at = [&](PoseId id) { return position[static_cast<std::size_t>(graph.IndexOf(id))]; };
      Arrival<Pose>& arrival = out[std::max(at(ends.first), at(ends.second))];
      arrival.factors.push_back(f);
      if (ends.count == 2) arrival.edges.push_back(std::get<RelativePoseFactor<Pose>>(factor));
    }
  }
  return out;
}

}  // namespace terse::internal
