#pragma once
// A pose as a line of a g2o file.

#include <ostream>

#include "terse/core/pose_graph.h"

namespace terse {

template <class Pose>
void WriteVertexLine(PoseId id, const Pose& T_world_body, std::ostream& out);

}  // namespace terse
