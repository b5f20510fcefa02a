#include "merge/joint_ids.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <unordered_set>

namespace terse::internal {
namespace {

// The smallest power of ten above n.
std::int64_t PowerOfTenAbove(std::uint64_t n) {
  std::int64_t power = 10;
  while (static_cast<std::uint64_t>(power) <= n) {
    if (power > std::numeric_limits<std::int64_t>::max() / 10)
      throw std::invalid_argument("the ids of the maps are too large to be kept apart in 64 bits");
    power *= 10;
  }
  return power;
}

}  // namespace

template <class Pose>
std::vector<std::int64_t> OffsetsOfIds(const std::vector<const CompactMap<Pose>*>& maps) {
  std::vector<std::int64_t> offsets(maps.size(), 0);
  std::unordered_set<std::int64_t> taken;
  std::uint64_t largest = 0;
  bool any_negative = false, collide = false;
  for (const CompactMap<Pose>* map : maps) {
    for (const auto& pose : map->poses) {
      const std::int64_t id = pose.id.value;
      collide = !taken.insert(id).second || collide;
      any_negative = any_negative || id < 0;
      largest = std::max(largest,
                         id < 0 ? std::uint64_t{0} - static_cast<std::uint64_t>(id) : static_cast<std::uint64_t>(id));
    }
  }
  if (!collide) return offsets;
  if (largest > std::uint64_t{1} << 62) largest = std::numeric_limits<std::uint64_t>::max() / 2;  // refused below
  const std::int64_t step = PowerOfTenAbove(any_negative ? 2 * largest : largest);
  for (std::size_t k = 0; k < maps.size(); ++k) {
    const auto times = static_cast<std::int64_t>(k);
    if (times > 0 && step > std::numeric_limits<std::int64_t>::max() / (times + 1))
      throw std::invalid_argument("the ids of the maps are too large to be kept apart in 64 bits");
    offsets[k] = times * step;
  }
  return offsets;
}

template <class Pose>
CompactMap<Pose> WithOffset(const CompactMap<Pose>& map, std::int64_t offset) {
  CompactMap<Pose> out = map;
  out.forgotten = 0;
  std::unordered_set<std::int64_t> known;
  for (const auto& pose : map.poses) known.insert(pose.id.value);
  const auto moved = [&](PoseId id) { return PoseId{id.value + offset}; };
  const auto move = [&](std::optional<PoseId>& id) {
    if (id) id = moved(*id);
  };
  // Of a measurement: the pose that it came in with, or one of its own.
  const auto came_with = [&](PoseId id, PoseId otherwise) {
    return moved(known.count(id.value) != 0 ? id : otherwise);
  };
  std::optional<PoseId> before;
  for (auto& pose : out.poses) {
    if (!pose.previous && before) pose.previous = PoseId{before->value - offset};  // it was forgotten
    pose.id = moved(pose.id);
    pose.base = moved(pose.base);
    for (auto* id : {&pose.previous, &pose.next_kept, &pose.anchored_to, &pose.ended_by}) move(*id);
    before = pose.id;
  }
  for (auto& edge : out.edges) {
    edge.added_at = came_with(edge.added_at, edge.measured.to);
    for (auto& part : edge.parts) {
      part.added_at = came_with(part.added_at, edge.measured.to);
      part.links.erase(
          std::remove_if(part.links.begin(), part.links.end(), [&](PoseId id) { return known.count(id.value) == 0; }),
          part.links.end());
      for (PoseId& id : part.links) id = moved(id);
    }
    for (PoseId& id : edge.composed_of) id = moved(id);
    edge.measured.from = moved(edge.measured.from);
    edge.measured.to = moved(edge.measured.to);
  }
  for (auto& prior : out.priors) {
    if (auto* pose = std::get_if<PosePriorFactor<Pose>>(&prior.measured)) pose->pose = moved(pose->pose);
    if (auto* position = std::get_if<PositionPriorFactor<Pose>>(&prior.measured))
      position->pose = moved(position->pose);
  }
  for (auto& fixed : out.fixed) fixed.pose = moved(fixed.pose);
  for (auto& refused : out.refused) {
    refused.candidate = moved(refused.candidate);
    refused.seen = moved(refused.seen);
  }
  for (auto& failed : out.failed) {
    failed.candidate = moved(failed.candidate);
    failed.seen = moved(failed.seen);
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                 \
  template std::vector<std::int64_t> OffsetsOfIds(const std::vector<const CompactMap<Pose>*>&); \
  template CompactMap<Pose> WithOffset(const CompactMap<Pose>&, std::int64_t);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
