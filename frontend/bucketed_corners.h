#pragma once
// Corners spread evenly over an image, where no tracks are yet.

#include <opencv2/core/mat.hpp>
#include <vector>

namespace terse {

struct CornerOptions {
  int wanted = 600;         // in the whole image, with those that are there
  int fast_threshold = 7;   // grey levels
  float min_strength = 30;  // smaller eigenvalue of the mean structure tensor, (grey levels / pixel)^2
  int border = 16;          // pixels
};

// New corners, whole pixels, best first within each bucket. derivatives: Scharr's, CV_16SC2, as
// cv::buildOpticalFlowPyramid gives them for the image. occupied: where tracks are.
std::vector<cv::Point2f> BucketedCorners(const cv::Mat& image, const cv::Mat& derivatives,
                                         const std::vector<cv::Point2f>& occupied, const CornerOptions& options);

}  // namespace terse
