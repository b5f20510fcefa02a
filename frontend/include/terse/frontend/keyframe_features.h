#pragma once
// What loop verification needs of a stereo keyframe, without its images.
//
// Corners (FAST, spread over a grid, on a pyramid), each with
//  - its place in both images, to sub-pixel: (u_L, v, u_R) at full resolution;
//  - a binary descriptor: 256 comparisons of smoothed grey values in its surroundings. Upright: it tolerates a roll of
//    some 20 degrees, as much as a vehicle sees, and tells more for that than one that turns with the image;
//  - a small patch of the left image at its own level, to find it again to sub-pixel.
// Corners without a counterpart in the right image are left out. Deterministic and thread-safe.

#include <array>
#include <cstdint>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "terse/frontend/stereo_camera.h"

namespace terse {

struct FeatureOptions {
  int most = 700;              // features in a keyframe, at most: about 210 bytes each
  int levels = 4;              // of the pyramid
  double level_scale = 1.4;    // from one to the next
  int fast_threshold = 10;     // grey levels; twice as many where that gives corners enough
  double min_disparity = 1;    // pixels
  double max_disparity = 0.2;  // of the image width
};

constexpr int kPatchSize = 11;  // pixels of its level, odd
using Patch = std::array<std::uint8_t, kPatchSize * kPatchSize>;
using BinaryDescriptor = std::array<std::uint64_t, 4>;

struct KeyframeFeatures {
  struct Point {
    float u = 0, v = 0, u_right = 0;  // pixels of the full image
    std::uint8_t level = 0;
  };
  std::vector<Point> points;
  std::vector<BinaryDescriptor> descriptors;  // as many
  std::vector<Patch> patches;                 // as many

  std::size_t Size() const { return points.size(); }
  std::size_t Bytes() const;
  Vector<3> Measured(std::size_t k) const { return {points[k].u, points[k].v, points[k].u_right}; }
};

// An image at several resolutions; the pixel centres of a level lie at (x + 1/2) scale - 1/2 of the full image.
struct ImagePyramid {
  std::vector<cv::Mat> levels;
  std::vector<double> scale_x, scale_y;  // of the full image to each level, at least 1

  ImagePyramid() = default;
  ImagePyramid(const cv::Mat& image, int count, double scale);
};

// The pyramids are those of an 8-bit grey stereo frame, made with the options' levels.
KeyframeFeatures ExtractFeatures(const ImagePyramid& left, const ImagePyramid& right, const FeatureOptions& options);

}  // namespace terse
