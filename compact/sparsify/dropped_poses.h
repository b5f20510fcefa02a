#pragma once
// A sparsified graph as a compact map: where each part comes from, and how dropped poses hang on those kept.

#include "terse/compact/compact_map.h"
#include "terse/compact/pose_elimination.h"

namespace terse::internal {

// `linked`: the graph before poses went, at its optimum, as `elimination` started from it. `holding`: LinkSystem's.
template <class Pose>
CompactMap<Pose> MapOf(const PoseGraph<Pose>& linked, const Elimination<Pose>& elimination,
                       const std::vector<FactorId>& holding, const std::vector<Pose>& T_world_body_whole);

}  // namespace terse::internal
