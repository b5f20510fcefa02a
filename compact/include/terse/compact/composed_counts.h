#pragma once
// What Strategy::kBounded made of the links of poses that it did not keep, counted in the map that there is.

#include "terse/compact/compact_map.h"

namespace terse {

struct ComposedCounts {
  long anchored = 0;      // poses found again at kept ones, whose chain started anew there
  long edges = 0;         // that hold a composed measurement
  long measurements = 0;  // composed ones, in these
  long fused = 0;         // edges of several measurements, odometry with others among them
};

// Zeros for the map of another strategy.
template <class Pose>
ComposedCounts CountComposed(const CompactMap<Pose>& map);

}  // namespace terse
