#pragma once
// The values of a graph's poses.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// By pose index; every pose has one.
template <class Pose>
std::vector<Pose> ValuesOf(const PoseGraph<Pose>& graph) {
  std::vector<Pose> values;
  values.reserve(graph.Poses().size());
  for (const auto& node : graph.Poses()) values.push_back(*node.T_world_body);
  return values;
}

}  // namespace terse::internal
