#include "composed_edges.h"

#include <algorithm>
#include <map>
#include <stdexcept>

#include "chains.h"
#include "pose_step.h"

namespace terse::internal {
namespace {

using std::size_t;

// Worth the work where it costs nothing, nats.
constexpr double kLeastFusedGain = 0.01;

template <class Pose>
using Ends = typename FusedEdges<Pose>::Ends;
template <class Pose>
using ChangedEdges = std::map<Ends<Pose>, typename FusedEdges<Pose>::Edge>;

// The edge as it is, before others fuse with it, as the first of its parts.
template <class Pose>
typename CompactMap<Pose>::Part FirstPart(const Ends<Pose>& ends, FactorId factor, const CompactParts<Pose>& parts) {
  typename CompactMap<Pose>::Part part;
  part.id = factor;
  const auto& measured = parts.map.Solver().Graph().FindFactor(factor)->factor;
  part.T_from_to = SeenFrom(ends.first, std::get<RelativePoseFactor<Pose>>(measured));
  part.added_at = parts.history.NewerOf(ends.first, ends.second);
  if (const auto* link = parts.links.Find(factor)) {
    part.added_at = link->added_at;
    part.gain = link->gain.value_or(0);
  }
  return part;
}

// The factors of these edges as their parts now make them, and the links that they are.
template <class Pose>
void ReplaceEdges(PoseId added_at, ChangedEdges<Pose>& changed, CompactParts<Pose>& parts,
                  std::optional<StepReport>& report) {
  GraphUpdate<Pose> update;
  for (const auto& [ends, edge] : changed) {
    if (edge.factor.value >= 0) update.removed.push_back(edge.factor);
    if (edge.is_odometry) update.odometry.push_back(update.factors.size());
    update.factors.push_back(
        Measurement(ends.first, ends.second, FusedEdges<Pose>::Sum(edge.parts), CompositionOrder::kFirst));
  }
  const StepReport done = parts.map.Update(update);
  Accumulate(done, report);
  size_t k = 0;
  for (auto& [ends, edge] : changed) {
    const FactorId factor = done.factor_ids[k++];
    if (edge.is_odometry) parts.history.SetOdometry(parts.history.NewerOf(ends.first, ends.second), factor);
    parts.links.SetEdge(ends, std::move(edge), factor, added_at);
  }
}

}  // namespace

template <class Pose>
bool IsJoined(PoseId a, PoseId b, const CompactParts<Pose>& parts) {
  return parts.links.Edges().Find(FusedEdges<Pose>::Ordered(a, b)) != nullptr;
}

template <class Pose>
double LeastEdgeGain(PoseId a, PoseId b, const CompactParts<Pose>& parts) {
  return IsJoined(a, b, parts) ? kLeastFusedGain : parts.gains.MinEdgeGain();
}

template <class Pose>
void AddEdges(PoseId added_at, std::vector<NewEdge<Pose>>& edges, CompactParts<Pose>& parts,
              std::optional<StepReport>& report) {
  using Fused = FusedEdges<Pose>;
  ChangedEdges<Pose> changed;
  for (NewEdge<Pose>& edge : edges) {
    const auto ends = Fused::Ordered(edge.a, edge.b);
    const typename Fused::Edge* known = parts.links.Edges().Find(ends);
    auto [it, is_first] = changed.emplace(ends, known != nullptr ? *known : typename Fused::Edge());
    typename Fused::Edge& entry = it->second;
    if (is_first && known != nullptr && entry.parts.empty()) {
      entry.parts.push_back(FirstPart<Pose>(ends, entry.factor, parts));
    }
    typename CompactMap<Pose>::Part part;
    part.id = edge.id = parts.links.NewPartId();
    part.added_at = added_at;
    part.gain = edge.gain;
    part.links = edge.links;
    part.T_from_to = ends.first == edge.a ? edge.T_a_b : Invert(edge.T_a_b);
    edge.fused = !entry.parts.empty();
    Fused::Append(std::move(part), entry.parts);
  }
  ReplaceEdges<Pose>(added_at, changed, parts, report);
}

template <class Pose>
void RemoveLink(FactorId id, CompactParts<Pose>& parts) {
  const auto unknown = [&] {
    throw std::invalid_argument("factor " + std::to_string(id.value) + " is not a link of the map");
  };
  const FusedEdges<Pose>& edges = parts.links.Edges();
  if (const auto fused = edges.FindPart(id); id.value != -1 && fused != edges.All().end()) {
    ChangedEdges<Pose> changed{{*fused}};
    auto& edge = changed.begin()->second;
    const auto part = std::find_if(edge.parts.begin(), edge.parts.end(), [&](const auto& p) { return p.id == id; });
    if (edge.is_odometry && part == edge.parts.begin()) unknown();
    if (edge.parts.size() > 1) {
      edge.parts.erase(part);
      std::optional<StepReport> report;
      ReplaceEdges<Pose>(parts.history.Newest(), changed, parts, report);
      return;
    }
    id = edge.factor;
  }
  if (parts.links.Find(id) == nullptr) unknown();
  const FactorPoses ends = PosesOf(parts.map.Solver().Graph().FindFactor(id)->factor);
  GraphUpdate<Pose> update;
  update.removed.push_back(id);
  parts.map.Update(update);
  parts.links.Remove(id, FusedEdges<Pose>::Ordered(ends.first, ends.second));
}

#define TERSE_INSTANTIATE(Pose)                                                                                 \
  template bool IsJoined(PoseId, PoseId, const CompactParts<Pose>&);                                            \
  template double LeastEdgeGain(PoseId, PoseId, const CompactParts<Pose>&);                                     \
  template void AddEdges(PoseId, std::vector<NewEdge<Pose>>&, CompactParts<Pose>&, std::optional<StepReport>&); \
  template void RemoveLink(FactorId, CompactParts<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
