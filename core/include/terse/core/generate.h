#pragma once
// Seeded synthetic data sets with exact ground truth, streamed: memory does not hold the graph.

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "terse/core/outliers.h"
#include "terse/core/pose_graph.h"

namespace terse {

// kEllipse: 170 poses over 72.29 m on two concentric 3D ellipses, semi-axes 10/6 m and 20/6 m (Ila et al. 2017 section
// 6). kEllipseN: N laps of the 20/6 ellipse. kSphere, kTorus, kManhattan (2D), kGarage: as the public sets of that
// name. However often a place of the ellipses is passed, a pose has at most 160 links: the 80 oldest, as a robot
// matches against its map, and the 80 newest. Memory and the time of a pose do not grow with the laps.
enum class Scene { kEllipse, kEllipseN, kSphere, kTorus, kManhattan, kGarage };
// std::nullopt if unknown. Names as on the command line: ellipse, ellipse-n, sphere, torus, manhattan, garage.
std::optional<Scene> SceneFromName(const std::string& name);

struct GenerateOptions {
  Scene scene = Scene::kEllipse;
  long poses = 0;  // 0: the scene's own default
  int laps = 10;   // kEllipseN
  // kManhattan: the sides of a rectangle that the robot does not leave, along x and y, m, and blocks of 1 m as well. Of
  // the two links that a pose has at most one is to the oldest pose in range, one to the newest. Without: a square that
  // grows with the number of poses, and the two newest.
  std::optional<std::array<long, 2>> area_m;
  std::uint64_t seed = 1;
  // Wrong loops (outliers.h) in per cent of the true ones. All else is the same to the last bit with and without.
  double wrong_loop_percent = 0;
  OutlierKind wrong_loop_kind = OutlierKind::kRandom;
  long slips = 0;  // odometry edges that go wrong (slips.h); all else is the same to the last bit
};

// Receives the data in online order: pose k, then all its edges to earlier poses (odometry first), then wrong loops.
template <class Pose>
struct GenerateSink {
  std::function<void(PoseId id, const Pose& T_world_body_true)> pose;
  std::function<void(const RelativePoseFactor<Pose>& edge)> edge;
  std::function<void(const RelativePoseFactor<Pose>& edge)> wrong_loop;
  std::function<void(const RelativePoseFactor<Pose>& edge)> slip;  // before the same comes as an edge
};

// True for the scenes that are planar.
bool IsPlanar(Scene scene);

// Same options, same data, on every machine. Throws std::invalid_argument for a scene of the other dimension,
// fewer than two poses, an area of another scene or smaller than one block, and wrong loops or slips that cannot be
// made.
template <class Pose>
void Generate(const GenerateOptions& options, const GenerateSink<Pose>& sink);

}  // namespace terse
