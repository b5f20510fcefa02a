#pragma once
// calib.txt of a KITTI odometry sequence.
//
// A line `P0: p00 p01 ... p23` is the 3x4 projection K [I | t] of a rectified camera: t (metres) maps camera 0's
// coordinates into its own, p = p_camera0 + t. Cameras 0 and 1 are the grey pair, 2 and 3 the colour pair.

#include <string>

#include "terse/frontend/stereo_camera.h"
#include "terse/lie/se3.h"

namespace terse {

struct KittiCalibration {
  StereoCamera camera;  // without the image size
  SE3 T_camera0_left;   // ground truth is that of camera 0, which is the left camera only of the grey pair
};

enum class KittiPair { kGrey, kColour };

// Throws FileError: a missing file, a pair that is not there or not a rectified one (each camera's own focal length or
// principal point, a baseline that is not positive).
KittiCalibration ReadKittiCalibration(const std::string& path, KittiPair pair);
// As P0 and P1. Throws FileError.
void WriteKittiCalibration(const StereoCamera& camera, const std::string& path);

}  // namespace terse
