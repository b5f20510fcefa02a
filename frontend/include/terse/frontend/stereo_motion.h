#pragma once
// The motion of a stereo camera between two frames from points that both see, and its covariance.

#include <optional>
#include <vector>

#include "terse/frontend/stereo_camera.h"
#include "terse/lie/se3.h"

namespace terse {

// One point as two stereo frames see it: (u_L, v_L, u_R), pixels.
struct StereoMatch {
  Vector<3> a, b;
};

}  // namespace terse
