#pragma once
// Bundle adjustment of the last few stereo frames: poses and points jointly, each point eliminated by its own 3x3 Schur
// complement. Points are image coordinates (u_L, v, u_R) in the first frame that sees them.

#include <vector>

#include "terse/frontend/stereo_camera.h"
#include "terse/lie/se3.h"

namespace terse {

struct WindowPoint {
  struct Observation {
    int frame;  // index into the poses, increasing
    Vector<3> uvu;
  };
  std::vector<Observation> observations;
};

struct WindowOptions {
  // Pixels, of the three residuals of one observation. Small: what a track drifts away in a window counts little.
  double huber = 0.3;
  int fixed = 1;       // poses held, the first ones
  int iterations = 4;  // at most
};

// What the window tells about a common offset of all disparities, with the points and the poses that are not held
// unknown: least squares of the offset is `step` away, with `information` (for unit noise, 1 / pixels^2). The poses are
// adjusted for offset 0. Held poses count as exact: their scale, which came with an earlier offset, speaks for it.
// Where the camera moves ahead, an offset makes near and far points disagree about how far.
struct WindowOffset {
  double information = 0, step = 0;  // step: what has to be added to u_R, pixels
};

// Adjusts T_world_camera from the second (`fixed`) on. They are left as they are if no step lowers the cost. Points
// with one observation are passed over. Deterministic.
WindowOffset AdjustWindow(const StereoCamera& camera, const std::vector<WindowPoint>& points,
                          const WindowOptions& options, std::vector<SE3>& T_world_camera);

}  // namespace terse
