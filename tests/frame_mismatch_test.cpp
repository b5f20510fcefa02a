// Signs of different frames: found where they were put in, and not where there are errors of an estimate only.

#include "terse/core/frame_mismatch.h"

#include <gtest/gtest.h>

#include <cmath>

#include "testing_poses.h"

namespace terse {
namespace {

using testing::PoseRandom;

struct Pair {
  std::vector<SE3> estimate, reference;
};

// A vehicle that winds ahead along its x axis, up and down a little; the estimate drifts and has noise.
Pair Drive(unsigned seed, int poses = 300, double drift = 0.002, double noise = 0.02) {
  PoseRandom random(seed);
  Pair out;
  SE3 T, T_estimate = testing::RandomPose<SE3>(random, 50);
  const double bias = 0.02 * random.Normal();
  for (int i = 0; i < poses; ++i) {
    SE3::Tangent step, error, jitter;
    step << 1, 0, 0, 0, 0.03 * std::cos(0.05 * i), bias + 0.1 * std::sin(0.03 * i);
    error << 10 * drift * random.NormalVector<3>(), drift * random.NormalVector<3>();
    jitter << noise * random.NormalVector<3>(), noise * random.NormalVector<3>();
    T = T.Retract(step);
    T_estimate = T_estimate.Retract(step).Retract(error);
    out.reference.push_back(T);
    out.estimate.push_back(T_estimate.Retract(jitter));
  }
  return out;
}

// Of a camera, z ahead and y down, in the axes of a vehicle: x ahead, z up.
SO3 CameraInVehicle() {
  Matrix<3, 3> R;
  R << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return SO3::FromMatrix(R);
}

TEST(FrameMismatch, ErrorsOfAnEstimateAreNone) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    const Pair p = Drive(seed);
    const auto found = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE3);
    EXPECT_FALSE(found) << seed << ": " << Describe(*found);
    EXPECT_FALSE(FindFrameMismatch(p.reference, p.reference, Alignment::kNone)) << "rounding";
  }
}

TEST(FrameMismatch, Scale) {
  for (unsigned seed = 1; seed <= 4; ++seed) {
    for (const double scale : {0.3048, 0.5, 1.6, 1000.0}) {
      Pair p = Drive(seed, 300, 0.0005);
      for (SE3& T : p.estimate) T = SE3(T.Rotation(), T.Translation() / scale);
      const auto found = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE3);
      ASSERT_TRUE(found && found->scale) << seed << ' ' << scale;
      EXPECT_NEAR(*found->scale / scale, 1, 0.1);
      EXPECT_FALSE(found->mirrored || found->R_body);
      EXPECT_LT(found->fitted_m, 0.5 * found->ate_m);
      EXPECT_NE(Describe(*found).find("times those of the estimate; with that the ATE would be"), std::string::npos);
    }
  }
}

TEST(FrameMismatch, BodyAxes) {
  Pair p = Drive(3);
  for (SE3& T : p.estimate) T = T * SE3(CameraInVehicle(), Vector<3>::Zero());
  const auto found = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE3);
  ASSERT_TRUE(found && found->R_body);
  EXPECT_LT((*found->R_body * CameraInVehicle()).Log().norm(), 0.2);
  EXPECT_FALSE(found->scale || found->mirrored || found->R_world);
  EXPECT_NE(Describe(*found).find("120 degrees at all poses (x y z of the reference's body are z -x -y"),
            std::string::npos)
      << Describe(*found);
}

// As a LiDAR's map with z up beside a camera's with y down: nothing that turns about z lays one over the other.
TEST(FrameMismatch, WorldAxes) {
  Pair p = Drive(4, 300, 0.0005);
  const SE3 T_camera_vehicle(CameraInVehicle().Inverse(), Vector<3>(3, 2, 1));
  const SE3 start = p.reference.front() * p.estimate.front().Inverse();
  for (SE3& T : p.estimate) T = T_camera_vehicle * start * T * T_camera_vehicle.Inverse();
  const auto found = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE2);
  ASSERT_TRUE(found && found->R_world);
  EXPECT_LT((*found->R_world * CameraInVehicle().Inverse()).Log().norm(), 0.1);
  EXPECT_NE(Describe(*found).find("see --align se3"), std::string::npos);
  const auto aligned = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE3);
  ASSERT_TRUE(aligned) << "the bodies still differ";
  EXPECT_FALSE(aligned->R_world);
  EXPECT_TRUE(aligned->R_body);
}

TEST(FrameMismatch, MirrorImages) {
  Pair p = Drive(5, 300, 0.0005);
  for (SE3& T : p.estimate) T = SE3(T.Rotation(), T.Translation().cwiseProduct(Vector<3>(1, -1, 1)));
  auto found = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE3);
  ASSERT_TRUE(found);
  EXPECT_TRUE(found->mirrored);
  EXPECT_FALSE(found->scale || found->R_body);
  for (SE3& T : p.estimate) T = SE3(T.Rotation(), 100 * T.Translation());
  found = FindFrameMismatch(p.estimate, p.reference, Alignment::kSE3);
  ASSERT_TRUE(found && found->scale);
  EXPECT_TRUE(found->mirrored);
  EXPECT_NEAR(*found->scale, 0.01, 0.001);
}

// Rotations about a line are not determined by the positions on it.
TEST(FrameMismatch, NothingOfLinesPointsAndFewPoses) {
  Pair line;
  PoseRandom random(6);
  for (int i = 0; i < 100; ++i) {
    line.reference.emplace_back(SO3(), Vector<3>(i, 0, 0));
    line.estimate.emplace_back(SO3::Exp({1, 0, 0}), Vector<3>(i, 0, 0) + 1e-3 * random.NormalVector<3>());
  }
  EXPECT_FALSE(FindFrameMismatch(line.estimate, line.reference, Alignment::kSE3));
  const std::vector<SE3> standing(20);
  EXPECT_FALSE(FindFrameMismatch(standing, standing, Alignment::kSE3));
  Pair few = Drive(7, 9);
  for (SE3& T : few.estimate) T = SE3(T.Rotation(), 2 * T.Translation());
  EXPECT_FALSE(FindFrameMismatch(few.estimate, few.reference, Alignment::kSE3));
}

}  // namespace
}  // namespace terse
