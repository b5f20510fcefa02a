#pragma once
// Pictures of a street. Visibility is exact: inverse depth is affine in the pixels of a plane, and each of four samples
// per pixel keeps the nearest. Textures are filtered by trilinear interpolation with several taps along the direction
// in which the surface is foreshortened.

#include <opencv2/core/mat.hpp>
#include <vector>

#include "street_scene.h"
#include "terse/frontend/stereo_camera.h"
#include "terse/lie/se3.h"

namespace terse {

// A pinhole without lens errors; pixels.
struct StreetView {
  double fx = 0, fy = 0, cx = 0, cy = 0;
  int width = 0, height = 0;
};

// Grey values without noise. Thread-safe.
cv::Mat1f RenderStreet(const StreetScene& scene, const StreetView& view, const SE3& T_world_camera);
// The z of what the centre of each pixel shows, metres; 0 where it shows nothing.
cv::Mat1f RenderStreetDepth(const StreetScene& scene, const StreetView& view, const SE3& T_world_camera);

}  // namespace terse
