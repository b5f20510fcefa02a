#pragma once
// Loops that lead from about one place to about one other.

#include <cstddef>
#include <utility>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// Of each pose, by index: its place in order of arrival (arrival.h). Throws as ArrivalSteps does.
template <class Pose>
std::vector<int> PlacesInArrival(const PoseGraph<Pose>& graph);

// `places`: of each loop, those of its two ends, the earlier one first. Loops whose ends are within ten places of each
// other's, directly or over others of the group, are a group; each is compared with no more than 32 of every
// neighbourhood. Groups as indices into `places`, both ascending. O(n log n).
std::vector<std::vector<std::size_t>> GroupLoops(const std::vector<std::pair<int, int>>& places);

}  // namespace terse::internal
