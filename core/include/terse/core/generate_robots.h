#pragma once
// Several robots in one Manhattan world: each drives as Scene::kManhattan has it, in a frame of its own that starts at
// its first pose. Links between robots come where one is at a place where another one was.

#include <cstdint>
#include <vector>

#include "terse/core/outliers.h"
#include "terse/core/pose_graph.h"

namespace terse {

struct RobotsOptions {
  int robots = 2;
  long poses = 3500;  // of each
  std::uint64_t seed = 1;
  // A pose of any robot but the first is linked with this probability, if another one came by.
  double link_probability = 0.05;
  // Wrong links between robots, in per cent of the true ones; all else is the same to the last bit with and without.
  double wrong_link_percent = 0;
  OutlierKind wrong_link_kind = OutlierKind::kRandom;  // or kGrouped
};

struct RobotLink {
  int from_robot = 0, to_robot = 0;
  RelativePoseFactor<SE2> measured;  // ids of their own graphs, which start at 0
  bool is_wrong = false;
};

struct RobotsData {
  std::vector<PoseGraph<SE2>> graphs;               // by robot, estimates composed, in its own frame
  std::vector<std::vector<SE2>> T_world_body_true;  // by robot and pose, in one world
  std::vector<RobotLink> links;                     // in the order of robots and poses, wrong ones among them
};

// Robots start anywhere in an area that they share in good part, turned by quarters. Same options, same data, on every
// machine. Throws std::invalid_argument for fewer than two robots or poses, another kind of wrong links, or numbers out
// of their domain.
RobotsData GenerateRobots(const RobotsOptions& options);

}  // namespace terse
