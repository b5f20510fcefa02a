#pragma once
// Image pyramids of a stereo frame and what is measured between two images: flow of points, start of a disparity.

#include <opencv2/core/mat.hpp>
#include <vector>

#include "terse/frontend/stereo_frame.h"

namespace terse {

constexpr int kFlowWindow = 11;  // pixels
constexpr int kFlowLevels = 4;

// Images and Scharr derivatives alternate, as cv::calcOpticalFlowPyrLK takes them.
using FlowPyramid = std::vector<cv::Mat>;

struct StereoPyramid {
  FlowPyramid left, right;
};

StereoPyramid BuildPyramids(const StereoFrame& frame);

// Level of a pyramid, 0 the largest.
const cv::Mat& Level(const FlowPyramid& pyramid, int level);

// Points of `from` in `to`, starting at `to_points`, which becomes the result; ok[k] = 0 where it was lost. With
// levels < kFlowLevels only the finer ones are used, for good starts.
void Flow(const FlowPyramid& from, const FlowPyramid& to, const std::vector<cv::Point2f>& from_points,
          std::vector<cv::Point2f>& to_points, std::vector<char>& ok, int levels);

// Clears ok[k] where tracking back from to_points misses from_points by more than `tolerance` pixels.
void CheckBackwards(const FlowPyramid& from, const FlowPyramid& to, const std::vector<cv::Point2f>& from_points,
                    const std::vector<cv::Point2f>& to_points, std::vector<char>& ok, double tolerance);

// Disparities of points of the left image, pixels, by block matching at a quarter of the size; negative where
// nothing matches clearly. Good to two pixels or so: a start for Flow.
std::vector<float> CoarseDisparities(const StereoPyramid& images, const std::vector<cv::Point2f>& points,
                                     double max_disparity);

// Mean over the points of the (clipped) difference of the patches around from[k] and to[k], their means removed, at a
// quarter of the size; a point outside the image counts as a full difference. Grey levels.
double PatchDifference(const FlowPyramid& from_image, const FlowPyramid& to_image, const std::vector<cv::Point2f>& from,
                       const std::vector<cv::Point2f>& to);

}  // namespace terse
