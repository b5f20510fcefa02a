#pragma once
// Ids of poses as options name them.

#include <string>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

// Both throw CLI::ValidationError, which names the option.
PoseId ParseId(const std::string& text, const std::string& option);
std::vector<PoseId> ParseIds(const std::string& text, const std::string& option);  // separated by commas

}  // namespace terse
