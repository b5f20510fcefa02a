#pragma once
// Poses that retire from a map under way (terse/compact/retire_poses.h).

#include <vector>

#include "compact_parts.h"
#include "terse/compact/retire_poses.h"

namespace terse::internal {

// Poses retire whose removal loses no more than this, nats, and the map that is left comes to its optimum. Factors that
// stay keep their ids. O(poses remembered) and a batch optimum of the map. Throws NumericalError, and leaves the map as
// it was, if that has none.
template <class Pose>
std::vector<RetiredPose> Retire(double most_loss, CompactParts<Pose>& parts);

// As CompactOptions::retire_share has it, now or, of a run under way, if it is time. Where the map has no optimum
// nothing retires.
template <class Pose>
std::vector<RetiredPose> RetireByShare(CompactParts<Pose>& parts);
template <class Pose>
std::vector<RetiredPose> RetireIfDue(CompactParts<Pose>& parts);

}  // namespace terse::internal
