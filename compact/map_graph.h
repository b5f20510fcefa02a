#pragma once
// A map as a graph.

#include "terse/compact/compact_map.h"

namespace terse::internal {

// Kept poses at their estimates, fixed ones where they are held; no factors.
template <class Pose>
PoseGraph<Pose> KeptPoses(const CompactMap<Pose>& map);

// The same with all that is measured, factors with their ids.
template <class Pose>
PoseGraph<Pose> GraphOfMap(const CompactMap<Pose>& map);

}  // namespace terse::internal
