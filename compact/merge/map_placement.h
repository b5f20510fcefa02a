#pragma once
// Where maps lie relative to each other, as far as links that agree in pairs and absolute measurements say.

#include <vector>

#include "merge/optimal_map.h"
#include "terse/compact/merge.h"

namespace terse::internal {

// A link with joint ids, between kept poses.
template <class Pose>
struct CarriedLink {
  int from_map = 0, to_map = 0;
  RelativePoseFactor<Pose> measured;
};

template <class Pose>
struct MapPlacement {
  std::vector<Placement> by;      // by map
  std::vector<Pose> T_joint_map;  // by map: of its own frame
  std::size_t reference = 0;      // the map whose frame the joint one is
  bool has_datum = false;         // absolute measurements say where that is
  std::vector<int> agreeing;      // by link (AgreeingLinks)
  // Of the limits that covariances as stated lead to, what the links have left of it; of the pair of maps that is put
  // together with the largest.
  double limit_share = 0;
  std::vector<std::size_t> members;  // the links by which maps are put together
  std::vector<std::size_t> holding;  // one of them for each pair of maps
  bool IsJoined(std::size_t map) const { return by[map] != Placement::kApart; }
};

// Along a spanning tree of the maps, what most links agree on first; the largest group of maps that hold together (of
// groups as large that with maps[0], else with the earliest map). Throws NumericalError if no two do.
template <class Pose>
MapPlacement<Pose> PlaceMaps(const std::vector<OptimalMap<Pose>>& maps, const std::vector<CarriedLink<Pose>>& links,
                             double pair_quantile, int most_compared);

}  // namespace terse::internal
