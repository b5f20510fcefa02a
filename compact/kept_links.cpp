#include "kept_links.h"

#include <algorithm>
#include <variant>

#include "terse/compact/state_members.h"

namespace terse::internal {
namespace {

// Of a factor among links in ascending order; their end if it is none of them.
template <class Links>
auto Place(FactorId factor, Links& links) {
  const auto it = std::lower_bound(links.begin(), links.end(), factor,
                                   [](const auto& link, FactorId wanted) { return link.factor < wanted; });
  return it != links.end() && it->factor == factor ? it : links.end();
}

}  // namespace

template <class Pose>
void KeptLinks<Pose>::TakeOptions(const CompactOptions<Pose>& options) {
  fuses_ = options.strategy == Strategy::kBounded;
  const RobustKernel kernel = options.solver.robust.kernel;
  fuses_odometry_ = fuses_ && (kernel == RobustKernel::kNone || kernel == RobustKernel::kGnc);
}

template <class Pose>
const typename KeptLinks<Pose>::Link* KeptLinks<Pose>::Find(FactorId factor) const {
  const auto link = Place(factor, links_);
  return link != links_.end() ? &*link : nullptr;
}

template <class Pose>
void KeptLinks<Pose>::AddLink(const Factor<Pose>& measured, const Link& link) {
  links_.push_back(link);
  const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&measured);
  if (fuses_ && edge != nullptr) fused_.Remember(fused_.Ordered(edge->from, edge->to), link.factor, false);
}

template <class Pose>
void KeptLinks<Pose>::AddOdometry(PoseId from, PoseId to, FactorId factor) {
  if (fuses_odometry_) fused_.Remember(fused_.Ordered(from, to), factor, true);
}

template <class Pose>
void KeptLinks<Pose>::SetGain(FactorId link, double gain) {
  Place(link, links_)->gain = gain;
}

template <class Pose>
void KeptLinks<Pose>::SetEdge(const Ends& ends, Edge edge, FactorId factor, PoseId added_at) {
  const FactorId before = std::exchange(edge.factor, factor);
  if (!edge.is_odometry) {
    const auto link = Place(before, links_);
    Link now{factor, link != links_.end() ? link->added_at : added_at, 0};
    for (const auto& part : edge.parts) *now.gain += part.gain;
    if (link != links_.end()) links_.erase(link);
    links_.push_back(now);
  }
  fused_.Set(ends, std::move(edge));
}

template <class Pose>
void KeptLinks<Pose>::Remove(FactorId link, const Ends& ends) {
  links_.erase(Place(link, links_));
  fused_.Forget(ends, link);
}

template <class Pose>
void KeptLinks<Pose>::Export(typename CompactMap<Pose>::Edge& edge) const {
  if (const Link* link = Find(edge.factor)) {
    edge.is_loop = true;
    edge.added_at = link->added_at;
    edge.gain = link->gain;
  }
  const Edge* fused = fused_.Find(fused_.Ordered(edge.measured.from, edge.measured.to));
  if (fused != nullptr && fused->factor == edge.factor) edge.parts = fused->parts;
}

template <class Pose>
void KeptLinks<Pose>::Clear() {
  const FactorId last = {NextPartId().value + 1};
  links_.clear();
  fused_ = {};
  fused_.Reserve(last);
}

// Of an edge that is numbered anew a part that was a factor itself has the id: no other has it.
template <class Pose>
void KeptLinks<Pose>::Restore(const typename CompactMap<Pose>::Edge& edge, FactorId factor) {
  if (edge.is_loop) {
    AddLink(edge.measured, {factor, edge.added_at, edge.gain});
  } else {
    AddOdometry(edge.measured.from, edge.measured.to, factor);
  }
  if (edge.parts.empty()) return;
  auto parts = edge.parts;
  for (auto& part : parts) {
    if (part.id.value >= 0 && factor != edge.factor) part.id = factor;
    fused_.Reserve(part.id);
  }
  fused_.Set(fused_.Ordered(edge.measured.from, edge.measured.to), {factor, !edge.is_loop, std::move(parts)});
}

template <class Pose>
template <class Archive>
void KeptLinks<Pose>::Serialize(Archive& archive) {
  auto& [fuses, fuses_odometry, links, fused] = *this;  // the first two are of the options
  archive.Each(links, [&](Link& link) {
    auto& [factor, added_at, gain] = link;
    archive(factor, added_at, gain);
  });
}

template <class Pose>
std::string KeptLinks<Pose>::FindStateDefect(const PoseGraph<Pose>& kept, const PoseHistory<Pose>& history) const {
  for (const auto& [ends, edge] : fused_.All()) {
    const FactorNode<Pose>* node = kept.FindFactor(edge.factor);
    const FactorPoses joined = node != nullptr ? PosesOf(node->factor) : FactorPoses();
    if (joined.count != 2 || fused_.Ordered(joined.first, joined.second) != ends)
      return "an edge that is not in the map";
  }
  for (const Link& link : links_) {
    const bool is_seen = history.Has(link.added_at) || history.IsForgotten(link.added_at);
    if (kept.FindFactor(link.factor) == nullptr || !is_seen) return "a link that is not in the map";
  }
  return "";
}

#define TERSE_INSTANTIATE(Pose)                                \
  template class KeptLinks<Pose>;                              \
  template void KeptLinks<Pose>::Serialize(StateWriter&);      \
  template void KeptLinks<Pose>::Serialize(StateReader&);      \
  template void KeptLinks<Pose>::SerializeEdges(StateWriter&); \
  template void KeptLinks<Pose>::SerializeEdges(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
