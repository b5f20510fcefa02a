#pragma once
// A rectified stereo pair of pinhole cameras.
//
// Camera frame: x right, y down, z along the optical axis, origin in the left camera, metres. Pixels: u right, v down,
// centre of the top left pixel at (0, 0). Both images have the same rows, so that a point is (u_L, v, u_R); measured,
// it is (u_L, v_L, u_R).

#include "terse/lie/types.h"

namespace terse {

struct StereoCamera {
  double fx = 0, fy = 0, cx = 0, cy = 0;  // pixels
  double baseline = 0;                    // metres, the right camera is at +x
  int width = 0, height = 0;              // pixels

  // (u_L, v, u_R) of a point in the camera frame with z > 0.
  Vector<3> Project(const Vector<3>& p) const;
  // d Project / d p.
  Matrix<3, 3> ProjectionJacobian(const Vector<3>& p) const;
  // The point of the camera frame that projects to (u_L, v, u_R). The disparity u_L - u_R must be positive.
  Vector<3> Triangulate(const Vector<3>& uvu) const;
};

}  // namespace terse
