#pragma once
// What a stereo camera sees at one time.

#include <opencv2/core/mat.hpp>

namespace terse {

// The images are rectified, 8-bit grey and as large as the camera says. cv::Mat shares its pixels when copied.
struct StereoFrame {
  int index = 0;    // in the sequence
  double time = 0;  // seconds
  cv::Mat left, right;
};

}  // namespace terse
