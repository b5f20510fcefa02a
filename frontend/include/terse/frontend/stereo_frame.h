#pragma once
// What a stereo camera delivers at one moment.

#include <opencv2/core/mat.hpp>

namespace terse {

struct StereoFrame {
  int index = 0;        // in its sequence
  double time = 0;      // seconds
  cv::Mat left, right;  // 8-bit grey, rectified, equally large
};

}  // namespace terse
