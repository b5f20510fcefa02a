#pragma once
// Thresholds of a compact run as a JSON file, thresholds.json of its folder:
//   {"dimension": 3, "range": [X, Y, Z, ANGLE], "probability": S, "min_loop_gain": G, "min_pose_gain": G,
//    "link_covariance": [6 rows of 6]}
// In 2D X, Y, ANGLE and 3 rows of 3; metres, radians, nats. Every number reads back to the last bit. Keys beyond these
// are ignored.

#include <string>

#include "terse/compact/threshold_values.h"

namespace terse {

// 2 or 3: what the file is for. Both throw FileError with the path and, where one is wrong, the key.
int ReadThresholdsDimension(const std::string& path);
template <class Pose>
Thresholds<Pose> ReadThresholds(const std::string& path);

// Written whole or not at all. Throws FileError.
template <class Pose>
void WriteThresholds(const Thresholds<Pose>& thresholds, const std::string& path);

}  // namespace terse
