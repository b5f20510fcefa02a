#pragma once
// Which features of two keyframes look alike?

#include <utility>
#include <vector>

#include "terse/frontend/keyframe_features.h"

namespace terse {

// Pairs (index in a, index in b) of descriptors that are nearest to each other, differ in at most `max_distance` bits,
// and in less than `ratio` of the bits that the next best of b does, features at the same place apart. O(|a| |b|).
std::vector<std::pair<int, int>> MatchDescriptors(const KeyframeFeatures& a, const KeyframeFeatures& b,
                                                  int max_distance, double ratio);

}  // namespace terse
