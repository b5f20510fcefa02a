#pragma once
// A map that is to be merged, at its own optimum.

#include <memory>
#include <string>

#include "terse/compact/compact_map.h"
#include "terse/covariance/marginals.h"

namespace terse::internal {

// What the absolute measurements of a map are.
enum class Absolute {
  kNone,
  kFrame,    // one pose is held, or has a prior: that is where somebody put the map's origin
  kPartial,  // they do not determine where the map is
  kDatum,
};

template <class Pose>
struct OptimalMap {
  CompactMap<Pose> map;  // kept poses at the optimum; without the loops that this contradicts
  PoseGraph<Pose> graph;
  std::unique_ptr<Marginals<Pose>> marginals;
  Absolute absolute = Absolute::kNone;
  int loops_out = 0;
};

// limit: of a loop's chi2, above which the optimum contradicts it. Throws NumericalError, which tells the name, if the
// map has no optimum.
template <class Pose>
OptimalMap<Pose> ToOptimum(CompactMap<Pose> map, const std::string& name, double limit, int threads);

}  // namespace terse::internal
