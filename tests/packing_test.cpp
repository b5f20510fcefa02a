// How coarse a packed graph may be (ChoosePacking).

#include "terse/covariance/packing.h"

#include <gtest/gtest.h>

#include <cmath>

#include "terse/covariance/information_scale.h"
#include "testing_scene.h"

namespace terse {
namespace {

constexpr double kShare = PackedPrecision().translation;

PoseGraph<SE2> City() { return testing::MakeScene<SE2>(Scene::kManhattan, 800, 5).graph; }

TEST(PackingTest, AsStatedWhereTheInformationIsRight) {
  const PackedPrecision precision = ChoosePacking(City());
  EXPECT_LE(precision.translation, kShare);
  EXPECT_LE(precision.rotation, kShare);
  EXPECT_GT(precision.translation, 0.8 * kShare);
  EXPECT_GT(precision.rotation, 0.8 * kShare);
  EXPECT_GT(ChoosePacking(City(), 0.5).translation, 0.4);
}

// A hundred times too cautious, as unit matrices are: a step of the stated deviation would be the whole measurement.
TEST(PackingTest, ByWhatResidualsShowWhereItIsTooCautious) {
  InformationScale scale;
  scale.odometry = scale.loops = {100, 30};
  const PackedPrecision right = ChoosePacking(City()), cautious = ChoosePacking(ScaleInformation(City(), scale));
  EXPECT_NEAR(std::log(cautious.translation / right.translation), -std::log(100), 0.3);
  EXPECT_NEAR(std::log(cautious.rotation / right.rotation), -std::log(30), 0.3);
}

TEST(PackingTest, TooCertainInformationIsTakenAtItsWord) {
  InformationScale scale;
  scale.odometry = scale.loops = {0.1, 0.1};
  EXPECT_EQ(ChoosePacking(ScaleInformation(City(), scale)).translation, kShare);
}

TEST(PackingTest, FinelyWhereNothingIsKnown) {
  PoseGraph<SE3> chain;
  chain.AddPose({0});
  for (int k = 1; k < 20; ++k) {
    chain.AddPose({k});
    chain.AddFactor(RelativePoseFactor<SE3>{{k - 1}, {k}, SE3(SO3(), Vector<3>(1, 0, 0)), SE3::Jacobian::Identity()});
  }
  EXPECT_EQ(ChoosePacking(chain).translation, 0.01 * kShare);
  EXPECT_EQ(ChoosePacking(chain).rotation, 0.01 * kShare);
  EXPECT_THROW(ChoosePacking(chain, 0), std::invalid_argument);
  EXPECT_THROW(ChoosePacking(chain, 2), std::invalid_argument);
}

}  // namespace
}  // namespace terse
