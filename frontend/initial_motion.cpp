#include <algorithm>
#include <opencv2/calib3d.hpp>

#include "terse/frontend/stereo_motion.h"

namespace terse {

std::optional<InitialMotionResult> InitialMotion(const StereoCamera& camera, const std::vector<StereoMatch>& matches,
                                                 const InitialMotionOptions& options) {
  std::vector<cv::Point3d> points;
  std::vector<cv::Point2d> pixels;
  std::vector<int> used;
  for (int k = 0; k < static_cast<int>(matches.size()); ++k) {
    const StereoMatch& match = matches[static_cast<size_t>(k)];
    if (match.a.x() - match.a.z() < options.min_disparity) continue;
    const Vector<3> p = camera.Triangulate(match.a);
    points.emplace_back(p.x(), p.y(), p.z());
    pixels.emplace_back(match.b.x(), match.b.y());
    used.push_back(k);
  }
  if (static_cast<int>(used.size()) < std::max(4, options.min_inliers)) return std::nullopt;

  const cv::Matx33d K(camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1);
  cv::Vec3d rotation, translation;
  std::vector<int> inliers;
  const bool found =
      cv::solvePnPRansac(points, pixels, K, cv::noArray(), rotation, translation, false, options.max_iterations,
                         static_cast<float>(options.threshold), options.confidence, inliers, cv::SOLVEPNP_P3P);
  if (!found || static_cast<int>(inliers.size()) < options.min_inliers) return std::nullopt;

  InitialMotionResult result;
  const SE3 T_b_a(SO3::Exp({rotation[0], rotation[1], rotation[2]}), {translation[0], translation[1], translation[2]});
  result.T_a_b = T_b_a.Inverse();
  result.inlier.assign(matches.size(), 0);
  for (const int k : inliers) result.inlier[static_cast<size_t>(used[static_cast<size_t>(k)])] = 1;
  result.inliers = static_cast<int>(inliers.size());
  return result;
}

}  // namespace terse
