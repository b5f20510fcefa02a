#pragma once
// Dropped poses that come back: a composed edge of the odometry is split where a loop leads to.

#include <optional>
#include <vector>

#include "compact_parts.h"

namespace terse::internal {

// Absent for a pose that is kept, whose chain has not ended at a kept pose, or cannot be split.
template <class Pose>
std::optional<Revival<Pose>> PlanRevival(PoseId dropped, const CompactParts<Pose>& parts);
// Of a pose on the chain of the pose at hand.
template <class Pose>
Revival<Pose> PlanRevivalOnChain(PoseId dropped, const CurrentPose<Pose>& current, const PoseHistory<Pose>& history);

// What it takes, as the first of an update; and after the update, with the ids of its factors, what is known of the
// pose and of the edges beside it.
template <class Pose>
void AddRevival(const Revival<Pose>& revival, const CompactParts<Pose>& parts, GraphUpdate<Pose>& update);
template <class Pose>
void Revive(const Revival<Pose>& revival, const std::vector<FactorId>& ids, CompactParts<Pose>& parts);

}  // namespace terse::internal
