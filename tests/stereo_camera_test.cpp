// Projection and triangulation are each other's inverse; the Jacobian against differences.

#include "terse/frontend/stereo_camera.h"

#include <gtest/gtest.h>

#include "testing.h"
#include "testing_jacobian.h"

namespace terse {
namespace {

using testing::Random;
using testing::Uniform;

const StereoCamera kCamera = {718.856, 718.856, 607.193, 185.216, 0.537, 1226, 370};

Vector<3> RandomPoint(Random& rng) {
  const double z = Uniform(rng, 2, 60);
  return {z * Uniform(rng, -0.8, 0.8), z * Uniform(rng, -0.25, 0.25), z};
}

TEST(StereoCamera, TriangulatesWhatItProjects) {
  Random rng(1);
  for (int trial = 0; trial < 100; ++trial) {
    const Vector<3> p = RandomPoint(rng);
    EXPECT_LT((kCamera.Triangulate(kCamera.Project(p)) - p).norm(), 1e-10 * p.norm());
  }
}

TEST(StereoCamera, TheRightCameraIsABaselineToTheRight) {
  const Vector<3> p = {1, 2, 10};
  const Vector<3> uvu = kCamera.Project(p);
  EXPECT_NEAR(uvu.x() - uvu.z(), kCamera.fx * kCamera.baseline / 10, 1e-12);
  StereoCamera right = kCamera;
  right.baseline = 0;
  EXPECT_NEAR(right.Project(p - Vector<3>(kCamera.baseline, 0, 0)).x(), uvu.z(), 1e-12);
}

TEST(StereoCamera, JacobianIsThatOfTheDifferences) {
  Random rng(2);
  for (int trial = 0; trial < 20; ++trial) {
    const Vector<3> p = RandomPoint(rng);
    const auto f = [&](const Vector<3>& d) { return Vector<3>(kCamera.Project(p + d)); };
    EXPECT_TRUE(testing::JacobianMatches(kCamera.ProjectionJacobian(p), f, 1e-5));
  }
}

}  // namespace
}  // namespace terse
