#pragma once
// Trajectories of graphs: ids for stamps, 2D poses in the plane z = 0.

#include <string>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/core/trajectory.h"

namespace terse {

inline SE3 InSpace(const SE2& T_a_b) { return Lift(T_a_b); }
inline const SE3& InSpace(const SE3& T_a_b) { return T_a_b; }

// Throws std::invalid_argument for an id beyond 2^53, where neighbouring ids would become the same stamp.
void RequireStampId(PoseId id);

// Poses by ascending id, ids for stamps.
template <class Pose>
Trajectory MakeTrajectory(const std::vector<PoseId>& ids, const std::vector<Pose>& T_world_body);

}  // namespace terse
