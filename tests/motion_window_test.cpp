// The window of an odometry: poses recovered from noisy points, and the common offset of the disparities with them.

#include <gtest/gtest.h>

#include <cmath>

#include "stereo_scene.h"
#include "terse/frontend/motion_window.h"

namespace terse {
namespace {

using testing::kKittiLike;
using testing::PoseRandom;

// Five frames a metre apart, `count` points that all of them see; `offset` is missing from every u_R.
std::vector<WindowPoint> Points(const std::vector<SE3>& T_world_camera, int count, double noise, double offset,
                                PoseRandom& rng) {
  std::vector<WindowPoint> points;
  while (static_cast<int>(points.size()) < count) {
    const double z = rng.LogUniform(8, 50);
    const Vector<3> p = {z * rng.Uniform(-0.8, 0.8), z * rng.Uniform(-0.25, 0.25), z};
    WindowPoint point;
    for (size_t k = 0; k < T_world_camera.size(); ++k) {
      const Vector<3> uvu = kKittiLike.Project(T_world_camera[k].Inverse() * p);
      point.observations.push_back(
          {static_cast<int>(k), uvu + noise * rng.NormalVector<3>() - Vector<3>(0, 0, offset)});
    }
    points.push_back(point);
  }
  return points;
}

std::vector<SE3> Poses() {
  std::vector<SE3> poses(1);
  while (poses.size() < 5) poses.push_back(poses.back() * testing::CarMotion());
  return poses;
}

TEST(MotionWindow, RecoversPosesAndHoldsTheFirst) {
  PoseRandom rng(1);
  const std::vector<SE3> truth = Poses();
  const auto points = Points(truth, 100, 0, 0, rng);
  for (const int fixed : {1, 3}) {
    std::vector<SE3> poses = truth;
    for (size_t k = static_cast<size_t>(fixed); k < poses.size(); ++k) {
      poses[k] = poses[k] * SE3::Exp(0.01 * rng.NormalVector<6>());
    }
    WindowOptions options;
    options.fixed = fixed;
    options.iterations = 20;
    AdjustWindow(kKittiLike, points, options, poses);
    for (size_t k = 0; k < poses.size(); ++k) {
      EXPECT_LT((poses[k].Inverse() * truth[k]).Log().norm(), k < static_cast<size_t>(fixed) ? 1e-12 : 1e-3) << k;
    }
  }
}

TEST(MotionWindow, FindsTheOffsetOfTheDisparities) {
  PoseRandom rng(2);
  const std::vector<SE3> truth = Poses();
  double sum = 0, information = 0;
  WindowOptions options;
  options.huber = 10;
  for (int trial = 0; trial < 10; ++trial) {
    std::vector<SE3> poses = truth;
    const auto offset = AdjustWindow(kKittiLike, Points(truth, 150, 0.2, 0.15, rng), options, poses);
    EXPECT_GT(offset.information, 0);
    sum += offset.information * offset.step;
    information += offset.information;
  }
  const double sigma = 0.2 / std::sqrt(information);
  EXPECT_LT(sigma, 0.05);
  EXPECT_NEAR(sum / information, 0.15, 3.5 * sigma);
}

TEST(MotionWindow, NothingToAdjust) {
  std::vector<SE3> poses = Poses();
  const auto offset = AdjustWindow(kKittiLike, {}, {}, poses);
  EXPECT_EQ(offset.information, 0);
  EXPECT_LT((poses[4].Inverse() * Poses()[4]).Log().norm(), 1e-15);
}

}  // namespace
}  // namespace terse
