#pragma once
// What comes to a growing pose graph in one step.

#include <cstddef>
#include <optional>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

template <class Pose>
struct GraphUpdate {
  struct NewPose {
    PoseId id;
    std::optional<Pose> T_world_body = std::nullopt;  // absent: composed along a factor
    bool fixed = false;                               // anchored at its value; the anchor is not counted in chi2
  };
  std::vector<NewPose> poses;
  std::vector<Factor<Pose>> factors;
  std::vector<FactorId> removed;
  // Positions in `factors` of relative factors that a robust kernel is not for, whatever they join: odometry. (Those
  // that bring a new pose are none of the kernel's in any case.)
  std::vector<std::size_t> odometry = {};
  // Empty, or an id for each of `factors`, ascending and none below the graph's NextFactorId: of a map that is put
  // together again.
  std::vector<FactorId> factor_ids = {};
};

}  // namespace terse
