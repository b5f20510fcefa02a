#pragma once

#include <string>

#include "terse/core/pose_graph.h"

namespace terse {

// As messages call it: "pose 7".
inline std::string Name(PoseId id) { return "pose " + std::to_string(id.value); }

}  // namespace terse
