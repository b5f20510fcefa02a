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
  double huber = 1;    // pixels, of the three residuals of one observation
  int fixed = 1;       // poses held, the first ones
  int iterations = 4;  // at most
};

// Adjusts T_world_camera from the second (`fixed`) on. They are left as they are if no step lowers the cost. Points
// with one observation are passed over. Deterministic.
void AdjustWindow(const StereoCamera& camera, const std::vector<WindowPoint>& points, const WindowOptions& options,
                  std::vector<SE3>& T_world_camera);

}  // namespace terse
