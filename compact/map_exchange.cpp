#include "map_exchange.h"

#include <algorithm>
#include <stdexcept>
#include <unordered_map>

#include "pose_recovery.h"

namespace terse::internal {
namespace {

using std::size_t;

template <class Pose>
using Edge = typename CompactMap<Pose>::Edge;

// A factor as it comes back; nullptr: it is a prior.
template <class Pose>
struct Arriving {
  FactorId factor;
  const Edge<Pose>* edge;
  Factor<Pose> measured;
};

// In order of arrival, as the ids were given.
template <class Pose>
std::vector<Arriving<Pose>> InOrder(const CompactMap<Pose>& map) {
  std::vector<Arriving<Pose>> order;
  for (const auto& edge : map.edges) order.push_back({edge.factor, &edge, edge.measured});
  for (const auto& prior : map.priors) order.push_back({prior.factor, nullptr, prior.measured});
  std::sort(order.begin(), order.end(), [](const auto& a, const auto& b) { return a.factor < b.factor; });
  return order;
}

template <class Pose>
std::vector<Pose> ValuesOfKept(const CompactMap<Pose>& map) {
  std::vector<Pose> values;
  for (const auto& pose : map.poses) {
    if (pose.kept) values.push_back(pose.T_world_body);
  }
  return values;
}

template <class Pose>
GraphUpdate<Pose> AsUpdate(const CompactMap<Pose>& map, const std::vector<Arriving<Pose>>& order, bool keeps_ids) {
  GraphUpdate<Pose> update;
  std::unordered_map<std::int64_t, size_t> place;  // in the update
  for (const auto& pose : map.poses) {
    if (!pose.kept) continue;
    place[pose.id.value] = update.poses.size();
    update.poses.push_back({pose.id, pose.T_world_body, false});
  }
  for (const auto& fixed : map.fixed) {
    update.poses[place.at(fixed.pose.value)] = {fixed.pose, fixed.T_world_body, true};
  }
  for (const Arriving<Pose>& factor : order) {
    if (factor.edge != nullptr && !factor.edge->is_loop) update.odometry.push_back(update.factors.size());
    update.factors.push_back(factor.measured);
    if (keeps_ids) update.factor_ids.push_back(factor.factor);
  }
  return update;
}

// The map itself first: it alone may fail.
template <class Pose>
void PutIn(const CompactMap<Pose>& map, bool keeps_ids, CompactParts<Pose>& parts) {
  const std::vector<Arriving<Pose>> order = InOrder(map);
  std::vector<FactorId> ids;
  if (!map.poses.empty()) ids = parts.map.Restore(AsUpdate(map, order, keeps_ids), ValuesOfKept(map)).factor_ids;
  PoseHistory<Pose> history;
  history.Restore(map.poses, map.forgotten);
  parts.history = std::move(history);
  parts.tests.Restore(map);
  parts.links.Clear();
  parts.search.Forget();
  parts.variance.Forget();
  for (size_t k = 0; k < order.size(); ++k) {
    const Edge<Pose>* edge = order[k].edge;
    if (edge == nullptr) continue;
    parts.links.Restore(*edge, ids[k]);
    if (edge->is_loop) continue;
    parts.history.SetOdometry(parts.history.NewerOf(edge->measured.from, edge->measured.to), ids[k]);
  }
}

}  // namespace

template <class Pose>
CompactMap<Pose> ExportMap(const CompactParts<Pose>& parts, Recovery recovery) {
  CompactMap<Pose> map;
  map.poses = parts.history.Export();
  map.forgotten = parts.history.Forgotten();
  size_t next = 0;
  for (const RecoveredPose<Pose>& pose : PoseRecovery<Pose>(parts.history, parts.map).Trajectory(recovery)) {
    map.poses[next++].T_world_body = pose.T_world_body;
  }
  const PoseGraph<Pose>& graph = parts.map.Solver().Graph();
  for (const auto& node : graph.Factors()) {
    const auto* measured = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (measured == nullptr) {
      map.priors.push_back({node.id, node.factor});
      continue;
    }
    Edge<Pose> edge;
    edge.factor = node.id;
    edge.measured = *measured;
    parts.links.Export(edge);
    if (!edge.is_loop) {
      edge.added_at = parts.history.NewerOf(measured->from, measured->to);
      edge.composed_of = parts.history.ChainTo(edge.added_at);
    }
    map.edges.push_back(std::move(edge));
  }
  for (const auto& node : graph.Poses()) {
    if (node.fixed) map.fixed.push_back({node.id, *node.T_world_body});
  }
  parts.tests.Export(map);
  return map;
}

template <class Pose>
void RestoreMap(const CompactMap<Pose>& map, CompactParts<Pose>& parts) {
  const std::string defect = FindDefect(map);
  if (!defect.empty()) throw std::invalid_argument(defect);
  PutIn(map, false, parts);
  std::vector<Pose> T_world_body;
  for (const auto& pose : map.poses) T_world_body.push_back(pose.T_world_body);
  if (!map.poses.empty()) parts.gains.Resume(parts.options, parts.map.Poses(), parts.links.Size(), T_world_body);
}

template <class Pose>
void ReplaceMap(const CompactMap<Pose>& map, CompactParts<Pose>& parts) {
  PutIn(map, true, parts);
}

#define TERSE_INSTANTIATE(Pose)                                             \
  template CompactMap<Pose> ExportMap(const CompactParts<Pose>&, Recovery); \
  template void RestoreMap(const CompactMap<Pose>&, CompactParts<Pose>&);   \
  template void ReplaceMap(const CompactMap<Pose>&, CompactParts<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
