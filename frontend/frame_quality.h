#pragma once
// What an image is worth for tracking, before any of it is tracked.

#include <opencv2/core/mat.hpp>

namespace terse {

struct FrameQuality {
  double mean = 0;       // grey levels
  double contrast = 0;   // standard deviation, grey levels
  double sharpness = 0;  // mean absolute difference of neighbours over the contrast, 1

  // Nothing can be seen.
  bool Blank() const { return contrast < 3; }
  bool Dark() const { return mean < 8; }
};

FrameQuality MeasureQuality(const cv::Mat& image);

bool SameImage(const cv::Mat& a, const cv::Mat& b);

}  // namespace terse
