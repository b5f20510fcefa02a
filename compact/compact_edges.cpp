// Edges of the map that several measurements make (compact_bounded.cpp composes them): they come to the solver, and can
// be taken out again one by one.

#include <algorithm>
#include <stdexcept>

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"

namespace terse {
namespace {

using internal::Measurement;
using std::size_t;

// Worth the work where it costs nothing, nats.
constexpr double kLeastFusedGain = 0.01;

}  // namespace

template <class Pose>
struct CompactPoseSlam<Pose>::ChangedEdges {
  std::map<typename FusedEdges<Pose>::Ends, typename FusedEdges<Pose>::Edge> edges;
};

// What an edge between the two must tell the map: nearly nothing if it fuses with one that is there.
template <class Pose>
double CompactPoseSlam<Pose>::LeastEdgeGain(PoseId a, PoseId b) const {
  return fused_->Find(FusedEdges<Pose>::Ordered(a, b)) != nullptr ? kLeastFusedGain : gains_->MinEdgeGain();
}

// Which factor joins two kept poses, so that others can fuse with it.
template <class Pose>
void CompactPoseSlam<Pose>::RememberEdge(const Factor<Pose>& factor, FactorId id, bool is_odometry) {
  const auto* measured = std::get_if<RelativePoseFactor<Pose>>(&factor);
  if (options_.strategy != Strategy::kBounded || measured == nullptr) return;
  // What a robust kernel may weigh does not become one with what it may not.
  if (is_odometry && options_.solver.robust.kernel != RobustKernel::kNone) return;
  fused_->Remember(FusedEdges<Pose>::Ordered(measured->from, measured->to), id, is_odometry);
}

template <class Pose>
typename std::vector<typename CompactPoseSlam<Pose>::Link>::iterator CompactPoseSlam<Pose>::FindLink(FactorId id) {
  const auto it = std::lower_bound(links_.begin(), links_.end(), id,
                                   [](const Link& link, FactorId wanted) { return link.factor < wanted; });
  return it != links_.end() && it->factor == id ? it : links_.end();
}

// The edge as it is, before others fuse with it, as the first of its parts.
template <class Pose>
typename CompactMap<Pose>::Part CompactPoseSlam<Pose>::FirstPart(PoseId from, PoseId to, FactorId factor) {
  typename CompactMap<Pose>::Part part;
  part.id = factor;
  part.T_from_to = SeenFrom(from, std::get<RelativePoseFactor<Pose>>(solver_->Graph().FindFactor(factor)->factor));
  part.added_at = history_->NewerOf(from, to);
  if (const auto link = FindLink(factor); link != links_.end()) {
    part.added_at = link->added_at;
    part.gain = link->gain.value_or(0);
  }
  return part;
}

// In one update. Those between the same two poses fuse with each other too. Throws NumericalError, and changes nothing,
// if the map has no solution with them.
template <class Pose>
void CompactPoseSlam<Pose>::AddEdges(PoseId added_at, std::vector<NewEdge>& edges, Decision& decision,
                                     std::optional<StepReport>& report) {
  using Fused = FusedEdges<Pose>;
  ChangedEdges changed;
  for (NewEdge& edge : edges) {
    const auto ends = Fused::Ordered(edge.a, edge.b);
    const typename Fused::Edge* known = fused_->Find(ends);
    auto [it, is_first] = changed.edges.emplace(ends, known != nullptr ? *known : typename Fused::Edge());
    typename Fused::Edge& entry = it->second;
    if (is_first && known != nullptr && entry.parts.empty()) {
      entry.parts.push_back(FirstPart(ends.first, ends.second, entry.factor));
    }
    typename CompactMap<Pose>::Part part;
    part.id = edge.id = fused_->NewPartId();
    part.added_at = added_at;
    part.gain = edge.gain;
    part.links = edge.links;
    part.T_from_to = ends.first == edge.a ? edge.T_a_b : Invert(edge.T_a_b);
    edge.fused = !entry.parts.empty();
    Fused::Append(std::move(part), entry.parts);
  }
  ReplaceEdges(added_at, changed, report);
  for (const NewEdge& edge : edges) {
    decision.edges.push_back({edge.id, edge.a, edge.b, edge.gain, edge.fused});
  }
}

// The factors of these edges as their parts now make them, and the links that they are.
template <class Pose>
void CompactPoseSlam<Pose>::ReplaceEdges(PoseId added_at, ChangedEdges& changed, std::optional<StepReport>& report) {
  using Fused = FusedEdges<Pose>;
  GraphUpdate<Pose> update;
  for (const auto& [ends, edge] : changed.edges) {
    if (edge.factor.value >= 0) update.removed.push_back(edge.factor);
    if (edge.is_odometry) update.odometry.push_back(update.factors.size());
    update.factors.push_back(Measurement(ends.first, ends.second, Fused::Sum(edge.parts), CompositionOrder::kFirst));
  }
  const StepReport done = solver_->Update(update);
  Accumulate(done, report);
  UpdateCovariances();
  size_t k = 0;
  for (auto& [ends, edge] : changed.edges) {
    const FactorId before = std::exchange(edge.factor, done.factor_ids[k++]);
    if (edge.is_odometry) {
      history_->SetOdometry(history_->NewerOf(ends.first, ends.second), edge.factor);
    } else {
      const auto link = FindLink(before);
      Link now{edge.factor, link != links_.end() ? link->added_at : added_at, 0};
      for (const auto& part : edge.parts) *now.gain += part.gain;
      if (link != links_.end()) links_.erase(link);
      links_.push_back(now);
    }
    fused_->Set(ends, std::move(edge));
  }
}

template <class Pose>
void CompactPoseSlam<Pose>::RemoveLink(FactorId id) {
  using Fused = FusedEdges<Pose>;
  const auto unknown = [&] {
    throw std::invalid_argument("factor " + std::to_string(id.value) + " is not a link of the map");
  };
  if (const auto fused = fused_->FindPart(id); id.value != -1 && fused != fused_->All().end()) {
    ChangedEdges changed{{*fused}};
    auto& edge = changed.edges.begin()->second;
    const auto part = std::find_if(edge.parts.begin(), edge.parts.end(), [&](const auto& p) { return p.id == id; });
    if (edge.is_odometry && part == edge.parts.begin()) unknown();
    if (edge.parts.size() > 1) {
      edge.parts.erase(part);
      std::optional<StepReport> report;
      ReplaceEdges(history_->Newest(), changed, report);
      return;
    }
    id = edge.factor;
  }
  const auto link = FindLink(id);
  if (link == links_.end()) unknown();
  const FactorPoses ends = PosesOf(solver_->Graph().FindFactor(id)->factor);
  GraphUpdate<Pose> update;
  update.removed.push_back(id);
  solver_->Update(update);
  UpdateCovariances();
  links_.erase(link);
  fused_->Forget(Fused::Ordered(ends.first, ends.second), id);
}

#define TERSE_INSTANTIATE(Pose)                                                                                        \
  template double CompactPoseSlam<Pose>::LeastEdgeGain(PoseId, PoseId) const;                                          \
  template void CompactPoseSlam<Pose>::RememberEdge(const Factor<Pose>&, FactorId, bool);                              \
  template std::vector<CompactPoseSlam<Pose>::Link>::iterator CompactPoseSlam<Pose>::FindLink(FactorId);               \
  template CompactMap<Pose>::Part CompactPoseSlam<Pose>::FirstPart(PoseId, PoseId, FactorId);                          \
  template void CompactPoseSlam<Pose>::AddEdges(PoseId, std::vector<NewEdge>&, Decision&, std::optional<StepReport>&); \
  template void CompactPoseSlam<Pose>::ReplaceEdges(PoseId, ChangedEdges&, std::optional<StepReport>&);                \
  template void CompactPoseSlam<Pose>::RemoveLink(FactorId);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
