#pragma once
// The results of a compact run as files: docs/outputs.md.

#include <string>
#include <vector>

#include "terse/compact/compact_pose_slam.h"
#include "terse/core/rotation_information.h"

namespace terse {

// Makes the folder if it is missing. Throws FileError, also if no file could be written into it.
void RequireFolder(const std::string& path);

void WriteDecisions(const std::vector<Decision>& decisions, const std::string& path);
// compact.g2o with the values of `result` and trajectory.tum.
template <class Pose>
void WriteCompactMap(const CompactPoseSlam<Pose>& slam, const BatchResult<Pose>& result, Recovery recovery,
                     RotationInformation rotation_information, const std::string& folder);

}  // namespace terse
