#pragma once
// A small textured corridor as a stereo camera sees it: ray casting against four walls, seeded, exact.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <opencv2/core.hpp>

#include "terse/frontend/stereo_camera.h"
#include "terse/frontend/stereo_frame.h"
#include "terse/lie/se3.h"

namespace terse::testing {

inline const StereoCamera kSmallCamera = {260, 260, 159.5, 79.5, 0.5, 320, 160};

class Corridor {
 public:
  explicit Corridor(std::uint32_t seed) : seed_(seed) {}

  StereoFrame Render(const StereoCamera& camera, const SE3& T_world_camera, int index, double gain = 1) const {
    StereoFrame frame;
    frame.index = index;
    frame.time = 0.1 * index;
    frame.left = View(camera, T_world_camera, 0, gain);
    frame.right = View(camera, T_world_camera, camera.baseline, gain);
    return frame;
  }

 private:
  cv::Mat View(const StereoCamera& camera, const SE3& T_world_camera, double offset, double gain) const {
    cv::Mat1b image(camera.height, camera.width);
    const Vector<3> origin = T_world_camera * Vector<3>(offset, 0, 0);
    for (int v = 0; v < camera.height; ++v) {
      for (int u = 0; u < camera.width; ++u) {
        const Vector<3> ray =
            T_world_camera.Rotation() * Vector<3>((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1);
        image(v, u) = cv::saturate_cast<uchar>(gain * Grey(origin, ray));
      }
    }
    return image;
  }

  // Walls at x = -4 and 5, floor at y = 1.6, ceiling at y = -4; y points down.
  double Grey(const Vector<3>& origin, const Vector<3>& ray) const {
    const double to_wall = ((ray.x() > 0 ? 5 : -4) - origin.x()) / ray.x();
    const double to_floor = ((ray.y() > 0 ? 1.6 : -4) - origin.y()) / ray.y();
    const bool wall = std::abs(ray.x()) > 1e-9 && (std::abs(ray.y()) < 1e-9 || to_wall < to_floor);
    const double distance = wall ? to_wall : to_floor;
    const Vector<3> p = origin + distance * ray;
    const double across = wall ? p.y() : p.x();
    const std::uint32_t plane = wall ? (ray.x() > 0) : 2 + (ray.y() > 0);
    double grey = 110;
    // What is finer than a pixel there is not drawn: it would alias.
    for (double cell = 1.6, contrast = 130; cell > distance / 110; cell /= 2, contrast *= 0.85) {
      grey += contrast * (Smooth(p.z() / cell, across / cell, plane) - 0.5);
    }
    return grey;
  }

  // Bilinear between random values at whole numbers.
  double Smooth(double x, double y, std::uint32_t plane) const {
    const double fx = std::floor(x), fy = std::floor(y);
    const int ix = static_cast<int>(fx), iy = static_cast<int>(fy);
    const double ax = x - fx, ay = y - fy;
    return (1 - ay) * ((1 - ax) * Noise(ix, iy, plane) + ax * Noise(ix + 1, iy, plane)) +
           ay * ((1 - ax) * Noise(ix, iy + 1, plane) + ax * Noise(ix + 1, iy + 1, plane));
  }

  double Noise(int x, int y, std::uint32_t salt) const {
    std::uint32_t h = seed_ + salt * 0x9e3779b9u + static_cast<std::uint32_t>(x) * 0x85ebca6bu;
    h = (h ^ (h >> 15)) * 0x2c1b3c6du + static_cast<std::uint32_t>(y) * 0xc2b2ae35u;
    h = (h ^ (h >> 12)) * 0x297a2d39u;
    return static_cast<double>((h ^ (h >> 15)) >> 8) / (1 << 24);
  }

  std::uint32_t seed_;
};

}  // namespace terse::testing
