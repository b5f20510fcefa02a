// Motion between two stereo frames: recovered from noisy matches with outliers; its covariance against the inverse of
// the dense Hessian of motion and points, and against Monte Carlo.

#include "terse/frontend/stereo_motion.h"

#include <gtest/gtest.h>

#include <Eigen/Cholesky>

#include <algorithm>
#include <cmath>
#include <opencv2/core.hpp>

#include "stereo_scene.h"

namespace terse {
namespace {

using testing::AddNoise;
using testing::CarMotion;
using testing::ExactMatches;
using testing::kKittiLike;
using testing::PoseRandom;

// The covariance for a noise of sigma pixels, nothing added: no robust weights, no factor, no floor.
StereoMotionOptions PlainOptions(double sigma) {
  StereoMotionOptions options;
  options.huber = 1e3;
  options.outlier = 1e3;
  options.min_disparity = 0.1;
  options.covariance_factor = 1;
  options.min_residual_scale = sigma;
  options.sigma_rho_floor = 0;
  options.sigma_phi_floor = 0;
  return options;
}

Vector<6> Error(const SE3& estimate, const SE3& truth) { return (estimate.Inverse() * truth).Log(); }

TEST(StereoMotion, ExactMatchesGiveTheMotionFromAPoorStart) {
  PoseRandom rng(1);
  const auto matches = ExactMatches(kKittiLike, CarMotion(), 60, rng);
  const auto motion = EstimateStereoMotion(kKittiLike, matches, {}, SE3());
  ASSERT_TRUE(motion);
  EXPECT_LT(Error(motion->T_a_b, CarMotion()).norm(), 1e-6);
  // Points that the motion brings closer than a pixel of disparity do not count.
  EXPECT_GE(motion->inliers, 55);
}

TEST(StereoMotion, OutliersAreLeftOutAndTheErrorFitsTheCovariance) {
  PoseRandom rng(2);
  StereoMotionOptions options;
  options.covariance_factor = 1;
  options.sigma_rho_floor = 0;
  options.sigma_phi_floor = 0;
  double nees = 0;
  constexpr int kTrials = 40, kMatches = 150;
  for (int trial = 0; trial < kTrials; ++trial) {
    auto matches = ExactMatches(kKittiLike, CarMotion(), kMatches, rng);
    AddNoise(matches, 0.3, rng);
    std::vector<char> wrong(matches.size(), 0);
    for (size_t k = 0; k < matches.size(); k += 3) {
      matches[k].b += Vector<3>(rng.Sign() * rng.Uniform(15, 60), rng.Uniform(-30, 30), rng.Uniform(-60, 60));
      wrong[k] = 1;
    }
    const auto initial = InitialMotion(kKittiLike, matches);
    ASSERT_TRUE(initial);
    const auto motion = EstimateStereoMotion(kKittiLike, matches, options, initial->T_a_b);
    ASSERT_TRUE(motion);
    for (size_t k = 0; k < matches.size(); ++k) EXPECT_FALSE(motion->inlier[k] && wrong[k]) << trial << " " << k;
    EXPECT_EQ(motion->inliers, std::count(motion->inlier.begin(), motion->inlier.end(), 1));
    EXPECT_GT(motion->inliers, kMatches / 2);
    EXPECT_NEAR(motion->residual_scale, 0.3, 0.06);
    const Vector<6> error = Error(motion->T_a_b, CarMotion());
    nees += error.dot(motion->covariance.llt().solve(error)) / 6 / kTrials;
  }
  // 240 degrees of freedom: a standard deviation of 0.09.
  EXPECT_GT(nees, 0.7);
  EXPECT_LT(nees, 1.4);
}

TEST(StereoMotion, CovarianceIsThatOfMonteCarlo) {
  PoseRandom rng(3);
  const auto matches = ExactMatches(kKittiLike, CarMotion(), 100, rng);
  const auto options = PlainOptions(1);
  const auto motion = EstimateStereoMotion(kKittiLike, matches, options, CarMotion());
  ASSERT_TRUE(motion);
  const auto sampled = MonteCarloCovariance(kKittiLike, matches, CarMotion(), 1, 400, 4, options);
  ASSERT_TRUE(sampled);
  // 400 samples: a standard deviation of 3.5 % each.
  for (int axis = 0; axis < 6; ++axis) {
    const double ratio = std::sqrt(motion->covariance(axis, axis) / (*sampled)(axis, axis));
    EXPECT_GT(ratio, 0.9) << axis;
    EXPECT_LT(ratio, 1.1) << axis;
  }
  const auto once = MonteCarloCovariance(kKittiLike, matches, CarMotion(), 1, 10, 4, options);
  const auto again = MonteCarloCovariance(kKittiLike, matches, CarMotion(), 1, 10, 4, options);
  EXPECT_EQ(*once, *again);
}

// Wrong matches are not sampled, and noise of a pixel is not cut off by bounds that are made for less.
TEST(StereoMotion, MonteCarloTakesTheInliersAndThePapersNoise) {
  PoseRandom rng(8);
  auto matches = ExactMatches(kKittiLike, CarMotion(), 120, rng);
  AddNoise(matches, 0.1, rng);
  const auto right = matches;
  for (size_t k = 0; k < matches.size(); k += 4) matches[k].b += Vector<3>(25, -12, 18);
  StereoMotionOptions tight;
  tight.huber = 0.2;
  tight.outlier = 1;
  const auto motion = EstimateStereoMotion(kKittiLike, matches, tight, CarMotion());
  ASSERT_TRUE(motion);
  ASSERT_EQ(motion->inliers, 90);
  MonteCarloOptions options;
  options.samples = 200;
  const auto sampled = MonteCarloCovariance(kKittiLike, matches, *motion, options, 3);
  ASSERT_TRUE(sampled);
  std::vector<StereoMatch> inliers;
  for (size_t k = 0; k < right.size(); ++k) {
    if (k % 4 != 0) inliers.push_back(right[k]);
  }
  const auto expected = EstimateStereoMotion(kKittiLike, inliers, PlainOptions(1), CarMotion());
  ASSERT_TRUE(expected);
  const double scale = expected->residual_scale;
  for (int axis = 0; axis < 6; ++axis) {
    const double sigma = std::sqrt(expected->covariance(axis, axis)) / scale;  // of one pixel
    EXPECT_NEAR(std::sqrt((*sampled)(axis, axis)) / sigma, 1, 0.2) << axis;    // 200 samples: 5 %
  }
  options.samples = 7;
  EXPECT_THROW(MonteCarloCovariance(kKittiLike, matches, *motion, options, 3), std::invalid_argument);
  options.samples = 8;
  options.sigma = 0;
  EXPECT_THROW(MonteCarloCovariance(kKittiLike, matches, *motion, options, 3), std::invalid_argument);
}

// The joint problem again, independently: points in space, Jacobians by differences, the whole Hessian inverted.
TEST(StereoMotion, CovarianceIsThatOfTheDenseJointProblem) {
  PoseRandom rng(5);
  constexpr int kPoints = 15, kSize = 6 + 3 * kPoints;
  const auto matches = ExactMatches(kKittiLike, CarMotion(), kPoints, rng);
  const auto motion = EstimateStereoMotion(kKittiLike, matches, PlainOptions(0.5), CarMotion());
  ASSERT_TRUE(motion);
  ASSERT_EQ(motion->inliers, kPoints);

  const auto predict = [&](const cv::Mat1d& d) {
    const SE3 T_b_a = CarMotion().Retract(Vector<6>(d.ptr<double>())).Inverse();
    cv::Mat1d predicted(6 * kPoints, 1);
    for (int k = 0; k < kPoints; ++k) {
      const Vector<3> p =
          kKittiLike.Triangulate(matches[static_cast<size_t>(k)].a) + Vector<3>(d.ptr<double>() + 6 + 3 * k);
      const Vector<3> a = kKittiLike.Project(p), b = kKittiLike.Project(T_b_a * p);
      for (int i = 0; i < 3; ++i) {
        predicted(6 * k + i) = a[i];
        predicted(6 * k + 3 + i) = b[i];
      }
    }
    return predicted;
  };
  cv::Mat1d J(6 * kPoints, kSize);
  for (int column = 0; column < kSize; ++column) {
    constexpr double kStep = 1e-5;
    cv::Mat1d plus(kSize, 1, 0.0), minus(kSize, 1, 0.0);
    plus(column) = kStep;
    minus(column) = -kStep;
    const cv::Mat derivative = (predict(plus) - predict(minus)) / (2 * kStep);
    derivative.copyTo(J.col(column));
  }
  const cv::Mat hessian = J.t() * J;
  cv::Mat1d covariance;
  cv::invert(4 * hessian, covariance, cv::DECOMP_CHOLESKY);  // 0.5 pixels
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 6; ++column) {
      const double scale = std::sqrt(covariance(row, row) * covariance(column, column));
      EXPECT_NEAR(motion->covariance(row, column), covariance(row, column), 1e-5 * scale) << row << " " << column;
    }
  }
}

TEST(StereoMotion, CovarianceHasAFloorAndAFactor) {
  PoseRandom rng(6);
  const auto matches = ExactMatches(kKittiLike, CarMotion(), 40, rng);
  auto options = PlainOptions(0.5);
  const auto plain = EstimateStereoMotion(kKittiLike, matches, options, CarMotion());
  options.covariance_factor = 3;
  options.sigma_rho_floor = 0.01;
  options.sigma_phi_floor = 0.001;
  const auto motion = EstimateStereoMotion(kKittiLike, matches, options, CarMotion());
  ASSERT_TRUE(plain && motion);
  Matrix<6, 6> expected = 3 * plain->covariance;
  expected.diagonal().head<3>().array() += 1e-4;
  expected.diagonal().tail<3>().array() += 1e-6;
  EXPECT_LT((motion->covariance - expected).norm(), 1e-9 * expected.norm());
}

// A step of the offset, and what it does to the estimate.
TEST(StereoMotion, KnowsHowAnOffsetOfTheDisparitiesMovesIt) {
  PoseRandom rng(9);
  auto matches = ExactMatches(kKittiLike, CarMotion(), 60, rng);
  const auto options = PlainOptions(1);
  const auto motion = EstimateStereoMotion(kKittiLike, matches, options, CarMotion());
  ASSERT_TRUE(motion);
  constexpr double kStep = 0.01;  // pixels
  for (StereoMatch& match : matches) {
    match.a.z() += kStep;
    match.b.z() += kStep;
  }
  const auto moved = EstimateStereoMotion(kKittiLike, matches, options, CarMotion());
  ASSERT_TRUE(moved);
  const Vector<6> expected = motion->T_a_b.Local(moved->T_a_b) / kStep;
  EXPECT_GT(expected.norm(), 1e-3);
  EXPECT_LT((motion->J_motion_offset - expected).norm(), 0.05 * expected.norm());
}

TEST(StereoMotion, NothingFromTooLittle) {
  PoseRandom rng(7);
  StereoMotionOptions options;
  auto few = ExactMatches(kKittiLike, CarMotion(), options.min_inliers - 1, rng);
  EXPECT_FALSE(EstimateStereoMotion(kKittiLike, few, options, SE3()));
  EXPECT_FALSE(InitialMotion(kKittiLike, few));
  EXPECT_FALSE(EstimateStereoMotion(kKittiLike, {}, options, SE3()));
  EXPECT_FALSE(InitialMotion(kKittiLike, {}));
  // Points at infinity determine the rotation only.
  auto far = ExactMatches(kKittiLike, SE3(), 50, rng);
  for (StereoMatch& match : far) match.a.z() = match.b.z() = match.a.x();
  options.min_disparity = 0;
  EXPECT_FALSE(EstimateStereoMotion(kKittiLike, far, options, SE3()));
}

TEST(InitialMotion, HalfOutliers) {
  PoseRandom rng(8);
  auto matches = ExactMatches(kKittiLike, CarMotion(), 120, rng);
  AddNoise(matches, 0.2, rng);
  for (size_t k = 0; k < matches.size(); k += 2) matches[k].b.x() += rng.Sign() * rng.Uniform(20, 100);
  const auto initial = InitialMotion(kKittiLike, matches);
  ASSERT_TRUE(initial);
  EXPECT_LT(Error(initial->T_a_b, CarMotion()).head<3>().norm(), 0.3);
  EXPECT_EQ(initial->inliers, std::count(initial->inlier.begin(), initial->inlier.end(), 1));
  EXPECT_GT(initial->inliers, 40);
  EXPECT_LE(initial->inliers, 60);
}

}  // namespace
}  // namespace terse
