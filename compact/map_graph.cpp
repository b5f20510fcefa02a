#include "map_graph.h"

#include <algorithm>

namespace terse::internal {

template <class Pose>
PoseGraph<Pose> KeptPoses(const CompactMap<Pose>& map) {
  PoseGraph<Pose> graph;
  for (const auto& pose : map.poses) {
    if (pose.kept) graph.AddPose(pose.id, pose.T_world_body);
  }
  for (const auto& fixed : map.fixed) {
    graph.SetPose(fixed.pose, fixed.T_world_body);
    graph.SetFixed(fixed.pose, true);
  }
  return graph;
}

template <class Pose>
PoseGraph<Pose> GraphOfMap(const CompactMap<Pose>& map) {
  PoseGraph<Pose> graph = KeptPoses(map);
  std::vector<std::pair<FactorId, Factor<Pose>>> factors;
  for (const auto& edge : map.edges) factors.emplace_back(edge.factor, edge.measured);
  for (const auto& prior : map.priors) factors.emplace_back(prior.factor, prior.measured);
  std::sort(factors.begin(), factors.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [id, factor] : factors) graph.AddFactor(factor, id);
  return graph;
}

#define TERSE_INSTANTIATE(Pose)                                \
  template PoseGraph<Pose> KeptPoses(const CompactMap<Pose>&); \
  template PoseGraph<Pose> GraphOfMap(const CompactMap<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
