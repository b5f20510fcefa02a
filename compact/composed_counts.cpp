#include "terse/compact/composed_counts.h"

namespace terse {

template <class Pose>
ComposedCounts CountComposed(const CompactMap<Pose>& map) {
  ComposedCounts counts;
  for (const auto& pose : map.poses) counts.anchored += pose.anchored_to.has_value();
  for (const auto& edge : map.edges) {
    long composed = 0, all = 0;
    for (const auto& part : edge.parts) {
      all += part.measurements;
      // What never was a factor of its own has a number below zero.
      if (part.id.value < 0) composed += part.measurements;
    }
    counts.edges += composed > 0;
    counts.measurements += composed;
    counts.fused += all > 1;
  }
  return counts;
}

template ComposedCounts CountComposed(const CompactMap<SE2>&);
template ComposedCounts CountComposed(const CompactMap<SE3>&);

}  // namespace terse
