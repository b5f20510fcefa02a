#include "track_measurement.h"

#include <cmath>

#include "lap_timer.h"
#include "stereo_reprojection.h"

namespace terse {
namespace {

constexpr double kMaxRowDifference = 1.0;  // pixels between v_L and v_R

cv::Point2f Left(const Vector<3>& uvu) { return {static_cast<float>(uvu.x()), static_cast<float>(uvu.y())}; }
cv::Point2f Right(const Vector<3>& uvu) { return {static_cast<float>(uvu.z()), static_cast<float>(uvu.y())}; }

bool DisparityAllowed(const StereoCamera& camera, const Vector<3>& uvu, const StereoOdometryOptions& options) {
  const double disparity = uvu.x() - uvu.z();
  return disparity >= options.min_disparity && disparity <= options.max_disparity * camera.width;
}

}  // namespace

std::vector<Vector<3>> PredictPoints(const StereoCamera& camera, const std::vector<Vector<3>>& points,
                                     const SE3& T_a_b) {
  const StereoReprojection reprojection(camera, T_a_b);
  std::vector<Vector<3>> predicted = points;
  for (size_t k = 0; k < points.size(); ++k) {
    Vector<3> uvu;
    if (reprojection.Project(points[k], uvu)) predicted[k] = uvu;
  }
  return predicted;
}

size_t ChooseMotion(const StereoCamera& camera, const StereoPyramid& a, const StereoPyramid& b,
                    const std::vector<Vector<3>>& points, const std::vector<SE3>& candidates) {
  constexpr size_t kPoints = 150;
  const size_t stride = points.size() / kPoints + 1;
  std::vector<Vector<3>> sample;
  std::vector<cv::Point2f> from;
  for (size_t k = 0; k < points.size(); k += stride) {
    sample.push_back(points[k]);
    from.push_back(Left(points[k]));
  }
  size_t best = 0;
  double best_difference = INFINITY;
  for (size_t candidate = 0; candidate < candidates.size(); ++candidate) {
    std::vector<cv::Point2f> to;
    for (const Vector<3>& uvu : PredictPoints(camera, sample, candidates[candidate])) to.push_back(Left(uvu));
    const double difference = PatchDifference(a.left, b.left, from, to);
    if (difference < best_difference) {
      best_difference = difference;
      best = candidate;
    }
  }
  return best;
}

TrackMeasurement MeasureTracks(const StereoCamera& camera, const StereoPyramid& a, const StereoPyramid& b,
                               const std::vector<Vector<3>>& points, const SE3& T_a_b, int levels,
                               const StereoOdometryOptions& options, OdometryTimes& times) {
  LapTimer timer;
  TrackMeasurement result;
  result.uvu = PredictPoints(camera, points, T_a_b);
  std::vector<cv::Point2f> left_a, left_b;
  for (size_t k = 0; k < points.size(); ++k) {
    left_a.push_back(Left(points[k]));
    left_b.push_back(Left(result.uvu[k]));
  }
  Flow(a.left, b.left, left_a, left_b, result.ok, levels);
  CheckBackwards(a.left, b.left, left_a, left_b, result.ok, options.forward_backward);
  times.tracking += timer.Lap();

  // The disparity starts at that of the prediction, where the left image was found.
  std::vector<size_t> kept;
  std::vector<cv::Point2f> right_a, right_b, left_kept;
  for (size_t k = 0; k < points.size(); ++k) {
    if (!result.ok[k]) continue;
    const float disparity = static_cast<float>(result.uvu[k].x() - result.uvu[k].z());
    kept.push_back(k);
    left_kept.push_back(left_b[k]);
    right_a.push_back(Right(points[k]));
    right_b.push_back(left_b[k] - cv::Point2f(disparity, 0));
  }
  std::vector<char> ok;
  Flow(b.left, b.right, left_kept, right_b, ok, 2);
  CheckBackwards(a.right, b.right, right_a, right_b, ok, options.circle);
  for (size_t i = 0; i < kept.size(); ++i) {
    const size_t k = kept[i];
    result.uvu[k] = {left_b[k].x, left_b[k].y, right_b[i].x};
    result.ok[k] = ok[i] && std::abs(right_b[i].y - left_b[k].y) <= kMaxRowDifference &&
                   DisparityAllowed(camera, result.uvu[k], options);
  }
  times.stereo += timer.Lap();
  return result;
}

std::vector<Vector<3>> MeasureDisparities(const StereoCamera& camera, const StereoPyramid& images,
                                          const std::vector<cv::Point2f>& corners,
                                          const StereoOdometryOptions& options) {
  const std::vector<float> disparities = CoarseDisparities(images, corners, options.max_disparity * camera.width);
  std::vector<cv::Point2f> left, right;
  for (size_t k = 0; k < corners.size(); ++k) {
    if (disparities[k] < 0) continue;
    left.push_back(corners[k]);
    right.push_back(corners[k] - cv::Point2f(disparities[k], 0));
  }
  std::vector<char> ok;
  Flow(images.left, images.right, left, right, ok, 3);
  CheckBackwards(images.left, images.right, left, right, ok, options.forward_backward);
  std::vector<Vector<3>> points;
  for (size_t k = 0; k < left.size(); ++k) {
    const Vector<3> uvu(left[k].x, left[k].y, right[k].x);
    if (ok[k] && std::abs(right[k].y - left[k].y) <= kMaxRowDifference && DisparityAllowed(camera, uvu, options)) {
      points.push_back(uvu);
    }
  }
  return points;
}

}  // namespace terse
