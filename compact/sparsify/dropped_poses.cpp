#include "dropped_poses.h"

#include <algorithm>
#include <map>
#include <memory>

#include "terse/compact/link_system.h"
#include "terse/core/at.h"
#include "terse/covariance/marginals.h"

namespace terse::internal {
namespace {

// Relative covariances within the connected parts of a graph, each with a gauge of its own.
template <class Pose>
class PartMarginals {
 public:
  explicit PartMarginals(const PoseGraph<Pose>& graph) : graph_(graph), parts_(SplitIntoParts(graph)) {
    for (std::size_t k = 0; k < parts_.size(); ++k) {
      for (const auto& node : parts_[k].Poses()) part_of_[node.id] = k;
    }
    marginals_.resize(parts_.size());
  }
  std::size_t PartOf(PoseId id) const { return part_of_.at(id); }
  UncertainPose<Pose> Between(PoseId a, PoseId b) {
    auto& marginals = marginals_[PartOf(a)];
    if (marginals == nullptr) {
      const auto& part = parts_[PartOf(a)];
      std::vector<Pose> values;
      for (const auto& node : part.Poses()) values.push_back(*node.T_world_body);
      marginals = std::make_unique<Marginals<Pose>>(part, std::move(values));
    }
    return {ValueOf(a).Inverse() * ValueOf(b), marginals->Relative(a, b)};
  }

 private:
  const Pose& ValueOf(PoseId id) const { return *graph_.Poses()[At(graph_.IndexOf(id))].T_world_body; }

  const PoseGraph<Pose>& graph_;
  const std::vector<PoseGraph<Pose>> parts_;
  std::map<PoseId, std::size_t> part_of_;
  std::vector<std::unique_ptr<Marginals<Pose>>> marginals_;  // those that were asked for
};

// A chain from the kept pose before to the one behind holds what the map before knew of the three.
template <class Pose>
std::vector<typename CompactMap<Pose>::SeenPose> SeenPoses(const PoseGraph<Pose>& linked, const PoseGraph<Pose>& kept,
                                                           const std::vector<Pose>& T_world_body_whole) {
  const auto& nodes = linked.Poses();
  PartMarginals<Pose> known(linked);
  std::vector<typename CompactMap<Pose>::SeenPose> seen(nodes.size());
  std::vector<int> last(nodes.size(), -1), last_kept(nodes.size(), -1);  // by part
  for (std::size_t v = 0; v < nodes.size(); ++v) {
    auto& pose = seen[v];
    int &before = last[known.PartOf(nodes[v].id)], &base = last_kept[known.PartOf(nodes[v].id)];
    pose.id = pose.base = nodes[v].id;
    pose.kept = kept.HasPose(pose.id);
    pose.T_world_body = *nodes[v].T_world_body;
    pose.T_world_body_when_seen = T_world_body_whole[v];
    if (v > 0) pose.previous = before >= 0 ? nodes[At(before)].id : nodes[v - 1].id;
    if (pose.kept) {
      base = static_cast<int>(v);
    } else {
      pose.base = nodes[At(base)].id;
      pose.T_base_pose = known.Between(pose.base, pose.id);
      pose.carried = true;
    }
    before = static_cast<int>(v);
  }
  std::vector<int> next(nodes.size(), -1);  // by part
  std::vector<UncertainPose<Pose>> to_next(nodes.size());
  for (int v = static_cast<int>(nodes.size()) - 1; v >= 0; --v) {
    const std::size_t part = known.PartOf(nodes[At(v)].id);
    auto& pose = seen[At(v)];
    if (pose.kept) {
      next[part] = v;
      to_next[part].covariance.setZero();
    } else if (next[part] >= 0) {
      if (to_next[part].covariance.isZero(0)) to_next[part] = known.Between(pose.base, nodes[At(next[part])].id);
      pose.next_kept = nodes[At(next[part])].id;
      pose.T_base_next = to_next[part];
    }
  }
  return seen;
}

}  // namespace

template <class Pose>
CompactMap<Pose> MapOf(const PoseGraph<Pose>& linked, const Elimination<Pose>& elimination,
                       const std::vector<FactorId>& holding, const std::vector<Pose>& T_world_body_whole) {
  CompactMap<Pose> map;
  const PoseGraph<Pose>& graph = elimination.graph;
  map.poses = SeenPoses(linked, graph, T_world_body_whole);
  auto recovered = elimination.recovered.begin();
  // By index in `linked`: how many kept poses came before.
  std::vector<int> rank(linked.Poses().size());
  for (std::size_t v = 0, kept = 0; v < rank.size(); ++v) {
    rank[v] = static_cast<int>(kept);
    kept += graph.HasPose(linked.Poses()[v].id);
  }
  for (const auto& node : graph.Factors()) {
    const auto* measured = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (measured == nullptr) {
      map.priors.push_back({node.id, node.factor});
      continue;
    }
    typename CompactMap<Pose>::Edge edge;
    edge.factor = node.id;
    edge.measured = *measured;
    const int from = linked.IndexOf(measured->from), to = linked.IndexOf(measured->to);
    edge.added_at = from < to ? measured->to : measured->from;
    edge.is_loop = !std::binary_search(holding.begin(), holding.end(), node.id);
    while (recovered != elimination.recovered.end() && recovered->factor < node.id) ++recovered;
    if (recovered != elimination.recovered.end() && recovered->factor == node.id) {
      edge.composed_of = {measured->from};
      edge.composed_of.insert(edge.composed_of.end(), recovered->through.begin(), recovered->through.end());
      edge.composed_of.push_back(measured->to);
      edge.is_loop = std::abs(rank[At(from)] - rank[At(to)]) != 1;
    }
    map.edges.push_back(std::move(edge));
  }
  for (const auto& node : graph.Poses()) {
    if (node.fixed) map.fixed.push_back({node.id, *node.T_world_body});
  }
  return map;
}

template CompactMap<SE2> MapOf(const PoseGraph<SE2>&, const Elimination<SE2>&, const std::vector<FactorId>&,
                               const std::vector<SE2>&);
template CompactMap<SE3> MapOf(const PoseGraph<SE3>&, const Elimination<SE3>&, const std::vector<FactorId>&,
                               const std::vector<SE3>&);

}  // namespace terse::internal
