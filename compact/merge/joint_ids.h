#pragma once
// Maps with ids of their own as parts of one.

#include <vector>

#include "terse/compact/compact_map.h"

namespace terse::internal {

// What is added to the ids of each map so that no two have the same: 0 for all if none have, else multiples of a power
// of ten that is larger than any map's ids. Throws std::invalid_argument if that leaves 64 bits.
template <class Pose>
std::vector<std::int64_t> OffsetsOfIds(const std::vector<const CompactMap<Pose>*>& maps);

// The map with such ids. What it names and does not remember any more (CompactMap::forgotten) is named no more.
template <class Pose>
CompactMap<Pose> WithOffset(const CompactMap<Pose>& map, std::int64_t offset);

}  // namespace terse::internal
