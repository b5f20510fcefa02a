#pragma once
// A compact run as a plain value (compact_map.h), and back.

#include "compact_parts.h"
#include "terse/compact/recovery.h"

namespace terse::internal {

template <class Pose>
CompactMap<Pose> ExportMap(const CompactParts<Pose>& parts, Recovery recovery);

// Into a run that has seen nothing yet. Throws std::invalid_argument if the map contradicts itself, NumericalError if
// its measurements do not hold it.
template <class Pose>
void RestoreMap(const CompactMap<Pose>& map, CompactParts<Pose>& parts);

// A map made of the run's own in its place. Factors keep their ids, thresholds in force stay. Throws as RestoreMap, and
// changes nothing.
template <class Pose>
void ReplaceMap(const CompactMap<Pose>& map, CompactParts<Pose>& parts);

}  // namespace terse::internal
