// Loops between frames of a rendered street and of a real one: found, accurate, with an honest covariance, and none
// between places that differ.

#include "terse/frontend/loop_verifier.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>
#include <cmath>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <stdexcept>

#include "shared_data.h"
#include "terse/core/trajectory.h"
#include "terse/frontend/kitti_sequence.h"
#include "terse/frontend/street_sequence.h"

namespace terse {
namespace {

StreetSequence SmallStreet() {
  StreetOptions options;
  options.width = 612;
  options.height = 184;
  return StreetSequence(options);
}

class LoopVerifierTest : public ::testing::Test {
 protected:
  LoopVerification Verify(int candidate, int current) {
    LoopVerifier verifier(street_.Camera());
    verifier.SetCurrent(street_.Render(candidate));
    verifier.Keep({candidate});
    verifier.SetCurrent(street_.Render(current));
    return verifier.Verify({candidate});
  }
  SE3 Truth(int a, int b) const { return street_.T_world_camera(a).Inverse() * street_.T_world_camera(b); }

  const StreetSequence street_ = SmallStreet();
};

// Half a lap ahead of any frame is its place on the second lap, but for a few metres.
TEST_F(LoopVerifierTest, FindsAPlaceAgainOnTheNextLap) {
  const int candidate = 20;
  int current = 150;
  for (int k = 150; k < 260; ++k) {
    if (Truth(candidate, k).Translation().norm() < Truth(candidate, current).Translation().norm()) current = k;
  }
  ASSERT_LT(Truth(candidate, current).Translation().norm(), 2);
  const LoopVerification loop = Verify(candidate, current);
  ASSERT_TRUE(loop.Verified()) << Name(loop.outcome);
  const Vector<6> error = loop.T_candidate_current.Local(Truth(candidate, current));
  EXPECT_LT(error.head<3>().norm(), 0.1);
  EXPECT_LT(error.tail<3>().norm(), 0.005);
  // Chi-square with 6 degrees of freedom exceeds 22.5 once in a thousand.
  EXPECT_LT(error.dot(loop.covariance.llt().solve(error)), 22.5);
  EXPECT_GE(loop.inliers, 40);
}

// A calibration that is off shows as scale; knowing by how much mends it.
TEST_F(LoopVerifierTest, TheDisparityOffsetIsTakenOutOfTheMotion) {
  StreetOptions options = street_.Options();
  options.disparity_offset = 0.6;
  const StreetSequence street(options);
  const SE3 truth = street.T_world_camera(20).Inverse() * street.T_world_camera(24);
  const auto error = [&](double offset) {
    LoopVerifier verifier(street.Camera());
    verifier.SetDisparityOffset(offset, 0.2);
    verifier.SetCurrent(street.Render(20));
    verifier.Keep({20});
    verifier.SetCurrent(street.Render(24));
    const LoopVerification loop = verifier.Verify({20});
    EXPECT_TRUE(loop.Verified()) << Name(loop.outcome);
    return (loop.T_candidate_current.Translation() - truth.Translation()).norm();
  };
  const double known = error(0.6);
  EXPECT_LT(known, 0.05);
  EXPECT_GT(error(0), 2 * known);
  EXPECT_GT(error(-0.6), 2 * known);
}

TEST_F(LoopVerifierTest, RefusesAnotherPlace) {
  const LoopVerification loop = Verify(20, 80);
  EXPECT_FALSE(loop.Verified()) << loop.inliers << " inliers";
}

TEST_F(LoopVerifierTest, SurvivesImagesThatShowNothing) {
  LoopVerifier verifier(street_.Camera());
  StereoFrame dark = street_.Render(0);
  dark.left.setTo(0);
  dark.right.setTo(0);
  verifier.SetCurrent(dark);
  EXPECT_EQ(verifier.CurrentFeatures().Size(), 0u);
  verifier.Keep({0});
  verifier.SetCurrent(street_.Render(0));
  EXPECT_EQ(verifier.Verify({0}).outcome, LoopOutcome::kFewMatches);
  verifier.Keep({1});
  verifier.SetCurrent(dark);
  EXPECT_EQ(verifier.Verify({1}).outcome, LoopOutcome::kFewMatches);
}

TEST_F(LoopVerifierTest, FeaturesAgreeWithTheScene) {
  const StereoFrame frame = street_.RenderClean(30);
  LoopVerifier verifier(street_.Camera());
  StereoFrame grey = frame;
  frame.left.convertTo(grey.left, CV_8U);
  frame.right.convertTo(grey.right, CV_8U);
  verifier.SetCurrent(grey);
  const KeyframeFeatures& features = verifier.CurrentFeatures();
  ASSERT_GT(features.Size(), 100u);
  const cv::Mat depth = street_.RenderDepth(30);
  int close = 0;
  for (std::size_t k = 0; k < features.Size(); ++k) {
    const KeyframeFeatures::Point& point = features.points[k];
    const double z = depth.at<float>(cvRound(point.v), cvRound(point.u));
    const double expected = z > 0 ? street_.Camera().fx * street_.Camera().baseline / z : 0;
    close += std::abs(point.u - point.u_right - expected - street_.Options().disparity_offset) < 0.5;
  }
  // The rest lies on edges of depth.
  EXPECT_GT(close, 0.85 * static_cast<double>(features.Size()));
}

TEST_F(LoopVerifierTest, StoresWhatIsKeptAndForgets) {
  LoopVerifier verifier(street_.Camera());
  LoopVerifierOptions options;
  options.features.levels = 0;
  EXPECT_THROW(LoopVerifier(street_.Camera(), options), std::invalid_argument);
  EXPECT_THROW(verifier.Keep({0}), std::invalid_argument);
  EXPECT_THROW(verifier.CurrentFeatures(), std::invalid_argument);
  verifier.SetCurrent(street_.Render(0));
  EXPECT_THROW(verifier.Verify({0}), std::invalid_argument);
  EXPECT_EQ(verifier.Bytes(), 0u);
  verifier.Keep({0});
  EXPECT_THROW(verifier.Keep({0}), std::invalid_argument);
  EXPECT_EQ(verifier.Kept(), 1u);
  EXPECT_GT(verifier.Bytes(), 10000u);
  EXPECT_LT(verifier.Bytes(), 150000u);
  StereoFrame wrong = street_.Render(1);
  cv::resize(wrong.right, wrong.right, {100, 50});
  EXPECT_THROW(verifier.SetCurrent(wrong), std::invalid_argument);
  EXPECT_TRUE(verifier.Verify({0}).Verified()) << "the frame before a wrong one is still there";
  verifier.Forget({0});
  EXPECT_FALSE(verifier.Has({0}));
  EXPECT_EQ(verifier.Bytes(), 0u);
}

TEST_F(LoopVerifierTest, RepeatsBitByBit) {
  const LoopVerification first = Verify(20, 23), second = Verify(20, 23);
  EXPECT_EQ(first.inliers, second.inliers);
  EXPECT_EQ(first.T_candidate_current.Log(), second.T_candidate_current.Log());
  EXPECT_EQ(first.covariance, second.covariance);
}

// The outcome and the motion stay, the covariance is the paper's: more than Schur's, which knows how good the matches
// are.
TEST_F(LoopVerifierTest, CovarianceByMonteCarlo) {
  LoopVerifierOptions options;
  options.covariance = MotionCovariance::kMonteCarlo;
  LoopVerifier verifier(street_.Camera(), options);
  verifier.SetCurrent(street_.Render(20));
  verifier.Keep({20});
  verifier.SetCurrent(street_.Render(23));
  const LoopVerification sampled = verifier.Verify({20}), schur = Verify(20, 23);
  ASSERT_TRUE(sampled.Verified());
  EXPECT_EQ(sampled.T_candidate_current.Log(), schur.T_candidate_current.Log());
  EXPECT_EQ(sampled.covariance, verifier.Verify({20}).covariance) << "repeats bit by bit";
  EXPECT_NE(sampled.covariance, schur.covariance);
  for (int axis = 0; axis < 6; ++axis) {
    const double ratio = std::sqrt(sampled.covariance(axis, axis) / schur.covariance(axis, axis));
    EXPECT_GT(ratio, 0.3) << axis;
    EXPECT_LT(ratio, 10) << axis;
  }
  options.monte_carlo.sigma = 0;
  EXPECT_THROW(LoopVerifier(street_.Camera(), options), std::invalid_argument);
}

// Even frames on the way out, odd ones on the way back.
TEST(LoopVerifierData, RevisitsOnARealStreet) {
  TERSE_NEEDS(path, "kitti/sequences/06");
  TERSE_NEEDS(poses, "kitti/poses/06.txt");
  const KittiSequence sequence(path);
  const std::vector<SE3> truth = ReadTrajectory(poses).T_world_body;
  LoopVerifier verifier(sequence.Camera());
  for (const int k : {20, 22, 24, 46}) {
    verifier.SetCurrent(sequence.Read(k));
    verifier.Keep({k});
  }
  verifier.SetCurrent(sequence.Read(23));
  for (const int k : {20, 22, 24}) {
    const LoopVerification loop = verifier.Verify({k});
    ASSERT_TRUE(loop.Verified()) << k << ' ' << Name(loop.outcome);
    const SE3 T = truth[static_cast<std::size_t>(k)].Inverse() * truth[23];
    const Vector<6> error = loop.T_candidate_current.Local(T);
    EXPECT_LT(error.head<3>().norm(), 0.08) << k;
    EXPECT_LT(error.tail<3>().norm(), 0.01) << k;
  }
  EXPECT_FALSE(verifier.Verify({46}).Verified()) << "from 27 m away";
}

}  // namespace
}  // namespace terse
