#include "merge/joint_ids.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <unordered_set>

namespace terse::internal {
namespace {

[[noreturn]] void ThrowTooLarge() {
  throw std::invalid_argument("the ids of the maps are too large to be kept apart in 64 bits");
}

std::int64_t Moved(PoseId id, std::int64_t offset) {
  std::int64_t moved = 0;
  if (__builtin_add_overflow(id.value, offset, &moved)) ThrowTooLarge();
  return moved;
}

// The smallest power of ten above n.
std::int64_t PowerOfTenAbove(std::uint64_t n) {
  std::int64_t power = 10;
  while (static_cast<std::uint64_t>(power) <= n) {
    if (power > std::numeric_limits<std::int64_t>::max() / 10) ThrowTooLarge();
    power *= 10;
  }
  return power;
}

// Of ids as moved.
struct Spread {
  std::uint64_t largest = 0;  // without its sign
  bool any_negative = false, collide = false;
};

template <class Pose>
Spread SpreadOf(const std::vector<const CompactMap<Pose>*>& maps, const std::vector<std::int64_t>& offsets) {
  Spread spread;
  std::unordered_set<std::int64_t> taken;
  for (std::size_t k = 0; k < maps.size(); ++k) {
    for (const auto& pose : maps[k]->poses) {
      const std::int64_t id = Moved(pose.id, offsets[k]);
      spread.collide = !taken.insert(id).second || spread.collide;
      spread.any_negative = spread.any_negative || id < 0;
      const auto bits = static_cast<std::uint64_t>(id);
      spread.largest = std::max(spread.largest, id < 0 ? std::uint64_t{0} - bits : bits);
    }
  }
  return spread;
}

}  // namespace

template <class Pose>
std::vector<std::int64_t> OffsetsOfIds(const std::vector<const CompactMap<Pose>*>& maps,
                                       const std::vector<std::optional<std::int64_t>>& given) {
  std::vector<std::int64_t> offsets;
  offsets.reserve(given.size());
  for (const auto& offset : given) offsets.push_back(offset.value_or(0));
  Spread spread = SpreadOf(maps, offsets);
  if (!spread.collide) return offsets;
  if (spread.largest > std::uint64_t{1} << 62) ThrowTooLarge();
  const std::int64_t step = PowerOfTenAbove(spread.any_negative ? 2 * spread.largest : spread.largest);
  for (std::size_t k = 0; k < maps.size(); ++k) {
    if (!given[k] && __builtin_mul_overflow(static_cast<std::int64_t>(k), step, &offsets[k])) ThrowTooLarge();
  }
  if (SpreadOf(maps, offsets).collide)
    throw std::invalid_argument("maps have poses of the same id, moved as their id_offset says");
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

#define TERSE_INSTANTIATE(Pose)                                                                     \
  template std::vector<std::int64_t> OffsetsOfIds(const std::vector<const CompactMap<Pose>*>&,      \
                                                  const std::vector<std::optional<std::int64_t>>&); \
  template CompactMap<Pose> WithOffset(const CompactMap<Pose>&, std::int64_t);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
