#pragma once
// Chordal relaxation, and rigid alignment to position priors. Private to the library.

#include <optional>
#include <vector>

#include "terse/core/initial_values.h"
#include "terse/core/pose_graph.h"

namespace terse::internal {

// See InitialValues::kChordal. `first` is pinned at T_world_first as far as the priors leave the frame free.
// The graph is connected.
template <class Pose>
std::vector<Pose> ChordalValues(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first,
                                const StartOptions& options);

// T_new_old with sum |T_new_old * translation - p_world|^2 minimal over the position priors; nullopt if they do not
// determine it.
template <class Pose>
std::optional<Pose> AlignToPositionPriors(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_old_body);

}  // namespace terse::internal
