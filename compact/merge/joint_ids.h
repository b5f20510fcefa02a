#pragma once
// Maps with ids of their own as parts of one.

#include <optional>
#include <vector>

#include "terse/compact/compact_map.h"

namespace terse::internal {

// What is added to the ids of each map so that no two have the same: as given, else 0 if none have then, else multiples
// of a power of ten that is larger than any map's ids. Throws std::invalid_argument if that leaves 64 bits, or if the
// given ones leave some the same.
template <class Pose>
std::vector<std::int64_t> OffsetsOfIds(const std::vector<const CompactMap<Pose>*>& maps,
                                       const std::vector<std::optional<std::int64_t>>& given);

// The map with such ids. What it names and does not remember any more (CompactMap::forgotten) is named no more.
template <class Pose>
CompactMap<Pose> WithOffset(const CompactMap<Pose>& map, std::int64_t offset);

}  // namespace terse::internal
