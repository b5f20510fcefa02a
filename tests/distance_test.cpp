// The distance test: first-order propagation against sampling and differences, the angle's singular places, and
// probabilities against counting.

#include "terse/compact/distance.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "testing.h"
#include "testing_jacobian.h"

namespace terse {
namespace {

using testing::Normal;
using testing::NormalVector;
using testing::Random;
using testing::Uniform;

constexpr double kPi = 3.14159265358979323846;
const Vector<3> kZ = {0, 0, 1};

double NormalTail(double deviations) { return std::erfc(deviations / std::sqrt(2.0)) / 2; }

// The definition of the header, without the library's formulas.
Vector<3> Displace(const SE2& T, const Vector<3>&) {
  return {T.Translation().x(), T.Translation().y(), std::atan2(T.Rotation()(1, 0), T.Rotation()(0, 0))};
}
Vector<4> Displace(const SE3& T, const Vector<3>& axis) {
  Vector<4> out;
  out << T.Translation(), std::acos(axis.dot(T.Rotation() * axis) / axis.squaredNorm());
  return out;
}

SO3 AxisAngle(const Vector<3>& axis, double radians) { return SO3::Exp(radians * axis.normalized()); }

Vector<3> Perpendicular(const Vector<3>& axis) { return axis.unitOrthogonal(); }

// Displacements whose view angle is well away from its singular places 0 and pi.
SE2 RegularPose(Random& rng, const SE2&, const Vector<3>&) {
  return SE2(3 * Normal(rng), 3 * Normal(rng), Uniform(rng, -2.5, 2.5));
}
SE3 RegularPose(Random& rng, const SE3&, const Vector<3>& axis) {
  const SO3 turned = AxisAngle(Perpendicular(axis), Uniform(rng, 0.5, 2.6));
  const SO3 R = AxisAngle(axis, Uniform(rng, -3, 3)) * turned * AxisAngle(axis, Uniform(rng, -3, 3));
  return SE3(R, 3 * NormalVector<3>(rng));
}

template <class Pose>
class DistanceTest : public ::testing::Test {
 public:
  static UncertainPose<Pose> RandomDisplacement(Random& rng, const Vector<3>& axis, double scale) {
    // An information matrix serves as well as any as a dense covariance.
    return {RegularPose(rng, Pose(), axis), testing::RandomInformation<Pose::kDof>(rng, scale * scale)};
  }
};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(DistanceTest, Groups);

TYPED_TEST(DistanceTest, MeanAndCovarianceMatchSampling) {
  constexpr int N = Displacement<TypeParam>::kSize;
  constexpr int kSamples = 100000;
  Random rng(1);
  for (int trial = 0; trial < 3; ++trial) {
    const auto T = TestFixture::RandomDisplacement(rng, kZ, 0.005);
    const auto displacement = ComputeDisplacement<TypeParam>(T);
    const Eigen::MatrixXd L = testing::CholeskyFactor(T.covariance);
    Vector<N> mean = Vector<N>::Zero();
    Matrix<N, N> second = Matrix<N, N>::Zero();
    for (int s = 0; s < kSamples; ++s) {
      const typename TypeParam::Tangent d = L * NormalVector<TypeParam::kDof>(rng);
      const Vector<N> x = Displace(T.T_a_b.Retract(d), kZ) - displacement.mean;
      mean += x / kSamples;
      second += x * x.transpose() / kSamples;
    }
    const Matrix<N, N> covariance = second - mean * mean.transpose();
    for (int i = 0; i < N; ++i) {
      const double sigma_i = std::sqrt(displacement.covariance(i, i));
      // Sampling: 5 sigma / sqrt(1e5) = 0.016 sigma. Second order: sigma^2 (cot(0.5) + 1) / 2 < 0.03 sigma.
      EXPECT_LT(std::abs(mean[i]), 0.05 * sigma_i);
      for (int j = 0; j < N; ++j) {
        // Sampling: 5 sqrt(2 / 1e5) = 0.022. Second order: some sigma^2 < 1e-3.
        const double scale = sigma_i * std::sqrt(displacement.covariance(j, j));
        EXPECT_LT(std::abs(covariance(i, j) - displacement.covariance(i, j)), 0.03 * scale) << i << " " << j;
      }
    }
  }
}

TYPED_TEST(DistanceTest, CovarianceIsThatOfTheNumericalJacobian) {
  constexpr int N = Displacement<TypeParam>::kSize;
  Random rng(2);
  for (const Vector<3>& axis :
       {kZ, Vector<3>(1, 0, 0), Vector<3>(0, -1, 0), Vector<3>(0.6, 0, 0.8), Vector<3>(2, -1, 3)}) {
    for (int trial = 0; trial < 50; ++trial) {
      // So small that the angle is far from 0 and pi beside it.
      const auto T = TestFixture::RandomDisplacement(rng, axis, 1e-6);
      const auto displacement = ComputeDisplacement<TypeParam>(T, axis);
      const auto f = [&](const typename TypeParam::Tangent& d) -> Vector<N> {
        return Displace(T.T_a_b.Retract(d), axis);
      };
      const auto J = testing::CentralDifferences<TypeParam::kDof>(f, 1e-5);
      EXPECT_LT((displacement.mean - f(TypeParam::Tangent::Zero())).norm(), 1e-12 * (1 + displacement.mean.norm()));
      // Differences are good to about 1e-10 in J.
      EXPECT_LT(testing::RelativeError(displacement.covariance, J * T.covariance * J.transpose()), 1e-8);
    }
  }
}

TEST(ViewAngle, RollAboutTheViewAxisChangesNothing) {
  Random rng(3);
  for (int trial = 0; trial < 200; ++trial) {
    const Vector<3> axis = trial % 2 == 0 ? kZ : Vector<3>(NormalVector<3>(rng).normalized());
    UncertainPose<SE3> T = DistanceTest<SE3>::RandomDisplacement(rng, axis, 0.1);
    if (trial % 5 == 0) T.T_a_b = SE3(AxisAngle(axis, Uniform(rng, -3, 3)), T.T_a_b.Translation());  // angle 0
    const auto plain = ComputeDisplacement<SE3>(T, axis);
    const UncertainPose<SE3> roll{SE3(AxisAngle(axis, Uniform(rng, -3, 3)), Vector<3>::Zero())};
    for (const auto& rolled : {Compose(T, roll), Compose(roll, T)}) {
      const auto displacement = ComputeDisplacement<SE3>(rolled, axis);
      EXPECT_NEAR(displacement.mean[3], plain.mean[3], 1e-12);
      EXPECT_NEAR(displacement.covariance(3, 3), plain.covariance(3, 3), 1e-9 * plain.covariance(3, 3));
    }
    // An error in roll does not enter either.
    UncertainPose<SE3> uncertain = T;
    uncertain.covariance.template bottomRightCorner<3, 3>() += 7 * axis * axis.transpose();
    EXPECT_NEAR(ComputeDisplacement<SE3>(uncertain, axis).covariance(3, 3), plain.covariance(3, 3),
                1e-9 * plain.covariance(3, 3));
  }
}

TEST(ViewAngle, AnotherViewAxisIsARotatedBodyFrame) {
  Random rng(4);
  for (int trial = 0; trial < 50; ++trial) {
    const Vector<3> axis = NormalVector<3>(rng).normalized();
    const auto T = DistanceTest<SE3>::RandomDisplacement(rng, axis, 0.1);
    const UncertainPose<SE3> Q{SE3(AxisAngle(kZ.cross(axis), std::acos(axis.z())), Vector<3>::Zero())};
    const auto expected = ComputeDisplacement<SE3>(Compose(Compose(Invert(Q), T), Q), kZ);
    const auto actual = ComputeDisplacement<SE3>(T, axis);
    EXPECT_NEAR(actual.mean[3], expected.mean[3], 1e-12);
    EXPECT_NEAR(actual.covariance(3, 3), expected.covariance(3, 3), 1e-9 * expected.covariance(3, 3));
    EXPECT_LT((Q.T_a_b.Rotation() * expected.mean.template head<3>() - actual.mean.template head<3>()).norm(), 1e-12);
  }
}

TEST(RotationAngle, CovarianceIsThatOfTheNumericalJacobian) {
  Random rng(9);
  for (int trial = 0; trial < 100; ++trial) {
    const SO3 R = AxisAngle(NormalVector<3>(rng), Uniform(rng, 0.5, 2.8));
    const UncertainPose<SE3> T{SE3(R, NormalVector<3>(rng)), testing::RandomInformation<6>(rng, 1e-12)};
    const auto displacement = ComputeDisplacement<SE3>(T, AngleMeasure::kRotation);
    const auto f = [&](const Vector<6>& d) -> Vector<4> {
      const SE3 moved = T.T_a_b.Retract(d);
      Vector<4> out;
      out << moved.Translation(), std::acos((moved.Rotation().Rotation().trace() - 1) / 2);
      return out;
    };
    const auto J = testing::CentralDifferences<6>(f, 1e-5);
    EXPECT_LT((displacement.mean - f(Vector<6>::Zero())).norm(), 1e-12 * (1 + displacement.mean.norm()));
    EXPECT_LT(testing::RelativeError(displacement.covariance, J * T.covariance * J.transpose()), 1e-8);
  }
}

// Two poses of any kind: e is the axis about which the second is turned, or its opposite.
struct Turn {
  Vector<3> axis, turn;
};
Turn RandomTurn(Random& rng, AngleMeasure measure) {
  const Vector<3> axis = NormalVector<3>(rng).normalized();
  const Vector<3> across = AxisAngle(axis, Uniform(rng, -3, 3)) * Perpendicular(axis);
  return {axis, measure == AngleMeasure::kRotation ? axis : across};
}

DistanceOptions Options(AngleMeasure measure, const Vector<3>& axis) {
  DistanceOptions options(measure);
  options.view_axis = axis;
  return options;
}

double LargestVariance(const UncertainPose<SE3>& T, const DistanceOptions& options, bool trace = false) {
  const Vector<3> e = options.view_axis.normalized();
  Eigen::Matrix3d P = Eigen::Matrix3d::Identity();
  if (options.angle == AngleMeasure::kViewDirection) P -= e * e.transpose();
  const Eigen::Matrix3d S = P * T.covariance.bottomRightCorner<3, 3>() * P;
  return trace ? S.trace() : testing::Eigenvalues(S)[2];
}

TEST(Angles, AtZeroAndPiTheVarianceIsThatOfTheHeader) {
  Random rng(5);
  for (int trial = 0; trial < 300; ++trial) {
    const auto measure = trial % 4 < 2 ? AngleMeasure::kViewDirection : AngleMeasure::kRotation;
    const auto [axis, turn] = RandomTurn(rng, measure);
    const auto options = Options(measure, axis);
    const double off[] = {0, 1e-12, 1e-9, 1e-7};
    const bool at_pi = trial % 2 == 1;
    const double angle = at_pi ? kPi - off[trial / 4 % 4] : off[trial / 4 % 4];
    UncertainPose<SE3> T;
    T.T_a_b = SE3(AxisAngle(turn, angle), NormalVector<3>(rng));
    if (measure == AngleMeasure::kViewDirection) {
      T.T_a_b = T.T_a_b * SE3(AxisAngle(axis, Uniform(rng, -3, 3)), Vector<3>::Zero());
    }
    T.covariance = testing::RandomInformation<6>(rng, 0.01);
    const auto displacement = ComputeDisplacement<SE3>(T, options);
    ASSERT_TRUE(displacement.mean.allFinite() && displacement.covariance.allFinite());
    // Rounding in a unit quaternion leaves some 1e-16 in the axes, and their angle at pi as far off.
    EXPECT_NEAR(displacement.mean[3], angle, 1e-14);
    double expected = LargestVariance(T, options, at_pi);
    if (at_pi && measure == AngleMeasure::kRotation) {
      expected = turn.dot(T.covariance.bottomRightCorner<3, 3>() * turn);  // a fold: the gradient but for its sign
    }
    EXPECT_NEAR(displacement.covariance(3, 3), expected, 1e-9 * expected);
  }
}

// No step from 0 to pi, and near 0 no dependence on which way the axis is turned. The matrix stays one.
TEST(Angles, VarianceIsContinuous) {
  Random rng(6);
  for (int trial = 0; trial < 10; ++trial) {
    const auto measure = trial % 2 == 0 ? AngleMeasure::kViewDirection : AngleMeasure::kRotation;
    const auto [axis, turn] = RandomTurn(rng, measure);
    const auto options = Options(measure, axis);
    const Matrix<6, 6> covariance = testing::RandomInformation<6>(rng, std::pow(10, -trial / 2 % 5));
    const auto at = [&](double angle, const Vector<3>& about) {
      const UncertainPose<SE3> T{SE3(AxisAngle(about, angle), Vector<3>(1, 2, 3)), covariance};
      const auto displacement = ComputeDisplacement<SE3>(T, options);
      const Eigen::VectorXd values = testing::Eigenvalues(displacement.covariance);
      EXPECT_GT(values[0], -1e-12 * values[3]);
      EXPECT_LE(displacement.covariance(3, 3), covariance.diagonal().tail<3>().sum() * (1 + 1e-12));
      return displacement;
    };
    std::vector<double> angles;
    for (double a = 1e-14; a < kPi / 2; a *= 1.005) angles.push_back(a), angles.push_back(kPi - a);
    std::sort(angles.begin(), angles.end());
    for (std::size_t k = 1; k < angles.size(); ++k) {
      const double before = at(angles[k - 1], turn).covariance(3, 3), after = at(angles[k], turn).covariance(3, 3);
      EXPECT_NEAR(after, before, 0.1 * before) << angles[k];
    }
    const double sigma = std::sqrt(covariance(5, 5));
    const Vector<3> other = AxisAngle(axis, 2) * (measure == AngleMeasure::kRotation ? Perpendicular(axis) : turn);
    const auto a = at(1e-4 * sigma, turn), b = at(1e-4 * sigma, other);
    EXPECT_LT((a.covariance.col(3) - b.covariance.col(3)).norm(), 1e-4 * a.covariance.norm());
  }
}

// The true probability by sampling, over means from 0 to pi.
TEST(Angles, ProbabilityIsNotBelowTheTrueOne) {
  constexpr int kSamples = 10000;
  Random rng(10);
  std::vector<Eigen::Matrix3d> covariances;
  for (const double sigma : {0.02, 0.1, 0.3, 0.6}) {
    covariances.push_back(sigma * sigma * Eigen::Matrix3d::Identity());
    for (const Vector<3>& scale : {Vector<3>(1, 0.1, 0.1), Vector<3>(0.1, 1, 1), Vector<3>(0.3, 1, 0.1)}) {
      const Vector<3> about = NormalVector<3>(rng);
      const Eigen::Matrix3d Q = AxisAngle(about, Uniform(rng, 0, 3)).Rotation();
      covariances.push_back(sigma * sigma * Q * scale.cwiseAbs2().asDiagonal() * Q.transpose());
    }
  }
  for (const auto measure : {AngleMeasure::kViewDirection, AngleMeasure::kRotation}) {
    double worst[3] = {1, 1, 1}, most_over = 0;
    for (const auto& Sigma : covariances) {
      const double sigma = std::sqrt(testing::Eigenvalues(Sigma).maxCoeff());
      const Eigen::Matrix3d L = testing::CholeskyFactor(Sigma);
      for (double mean : {0.0, 0.3 * sigma, sigma, 2 * sigma, 0.5, 1.0, 1.5, 2.0, 2.5, kPi - 2 * sigma, kPi - sigma,
                          kPi - 0.3 * sigma, kPi}) {
        if (mean < 0 || mean > kPi) continue;
        const auto [axis, turn] = RandomTurn(rng, measure);
        const auto options = Options(measure, axis);
        UncertainPose<SE3> T{SE3(AxisAngle(turn, mean), Vector<3>::Zero())};
        T.covariance.bottomRightCorner<3, 3>() = Sigma;
        const auto displacement = ComputeDisplacement<SE3>(T, options);
        std::vector<double> angles;
        for (int s = 0; s < kSamples; ++s) {
          const SO3 R = T.T_a_b.Rotation() * SO3::Exp(L * Eigen::Vector3d(NormalVector<3>(rng)));
          angles.push_back(DisplacementMean<SE3>(SE3(R, Vector<3>::Zero()), options)[3]);
        }
        std::sort(angles.begin(), angles.end());
        for (const double share : {0.1, 0.15, 0.2, 0.3, 0.5}) {
          const double range = angles[static_cast<std::size_t>(share * kSamples)];
          const double p = RangeProbabilities<SE3>(displacement, Vector<4>(1, 1, 1, range))[3];
          const double noise = 4 * std::sqrt(share * (1 - share) / kSamples);
          const int band = mean <= 1 ? 0 : share <= 0.2 ? 1 : 2;
          worst[band] = std::min(worst[band], (p + noise) / share);
          most_over = std::max(most_over, p - share);
        }
      }
    }
    // What docs/algorithms.md says. Rotations: always. View directions: the error across the gradient bends the axes
    // towards or away from each other, of which a normal distribution about the mean can have part only.
    const bool always = measure == AngleMeasure::kRotation;
    EXPECT_GE(worst[0], always ? 0.98 : 0.6);
    EXPECT_GE(worst[1], always ? 0.98 : 0.4);
    EXPECT_GE(worst[2], always ? 0.98 : 0.7);
    EXPECT_LT(most_over, 0.5);
  }
}

TEST(ViewAngle, NoErrorAcrossTheAxisIsNoVariance) {
  UncertainPose<SE3> T;
  T.covariance(5, 5) = 1;  // in roll only
  EXPECT_EQ(ComputeDisplacement<SE3>(T).covariance(3, 3), 0);
}

template <int N>
Displacement<std::conditional_t<N == 3, SE2, SE3>> MakeDisplacement(double length, double angle, double sigma) {
  Displacement<std::conditional_t<N == 3, SE2, SE3>> out;
  out.mean = Vector<N>::Constant(length);
  out.mean[N - 1] = angle;
  out.covariance = sigma * sigma * Matrix<N, N>::Identity();
  return out;
}

TYPED_TEST(DistanceTest, ProbabilitiesMatchCounting) {
  constexpr int N = Displacement<TypeParam>::kSize;
  constexpr int kSamples = 100000;
  Random rng(7);
  for (int trial = 0; trial < 20; ++trial) {
    Displacement<TypeParam> d;
    d.mean = 2 * NormalVector<N>(rng);
    d.mean[N - 1] = Uniform(rng, 0, kPi);
    d.covariance = testing::RandomInformation<N>(rng, trial % 2 == 0 ? 0.05 : 1.5);
    Vector<N> range = NormalVector<N>(rng).cwiseAbs() + Vector<N>::Constant(0.1);
    range[N - 1] = Uniform(rng, 0.2, 3.1);
    const auto probability = RangeProbabilities<TypeParam>(d, range);
    for (int k = 0; k < N; ++k) {
      double inside = 0;
      for (int s = 0; s < kSamples; ++s) {
        double x = d.mean[k] + std::sqrt(d.covariance(k, k)) * Normal(rng);
        if (k == N - 1) x = std::remainder(x, 2 * kPi);
        inside += std::abs(x) <= range[k] ? 1.0 / kSamples : 0;
      }
      // 5 sqrt(p (1 - p) / 1e5) <= 0.008
      EXPECT_NEAR(probability[k], inside, 0.008) << "dimension " << k;
    }
  }
}

// Against many random points of the box, and a fine descent from the nearest of them.
TEST(DistanceToRange, IsTheLeastOverTheBox) {
  Random rng(3);
  for (int round = 0; round < 60; ++round) {
    Displacement<SE2> d;
    Matrix<3, 3> root;
    for (int i = 0; i < 9; ++i) root(i / 3, i % 3) = Normal(rng);
    d.covariance = 0.3 * root * root.transpose() + 0.01 * Matrix<3, 3>::Identity();
    if (d.covariance(2, 2) >= 1) continue;
    d.mean = Vector<3>(Uniform(rng, -6, 6), Uniform(rng, -6, 6), Uniform(rng, -2, 2));
    const Vector<3> range(Uniform(rng, 0.2, 3), Uniform(rng, 0.2, 3), Uniform(rng, 0.1, 2));
    const Matrix<3, 3> information = d.covariance.inverse();
    const auto cost = [&](const Vector<3>& x) { return (x - d.mean).dot(information * (x - d.mean)); };
    Vector<3> best = d.mean.cwiseMin(range).cwiseMax(-range);
    double least = cost(best);
    for (double width = 1; width > 1e-5; width *= 0.7) {
      for (int k = 0; k < 60; ++k) {
        Vector<3> x = best + width * range.cwiseProduct(NormalVector<3>(rng));
        x = x.cwiseMin(range).cwiseMax(-range);
        if (cost(x) < least) least = cost(best = x);
      }
    }
    EXPECT_NEAR(DistanceToRange<SE2>(d, range), least, 1e-3 * least + 1e-9) << "round " << round;
    EXPECT_LE(DistanceToRange<SE2>(d, range, 2 * least + 1), 2 * least + 1) << "round " << round;
  }
}

TEST(DistanceToRange, SpecialCases) {
  const Vector<4> range(1, 1, 1, 0.5);
  EXPECT_EQ(DistanceToRange<SE3>(MakeDisplacement<4>(0.5, 0.2, 1), range), 0) << "inside";
  EXPECT_GT(DistanceToRange<SE3>(MakeDisplacement<4>(0.5, 2, 0.1), range), 100) << "turned away";
  EXPECT_EQ(DistanceToRange<SE3>(MakeDisplacement<4>(0.5, 2, 2), range), 0) << "the angle may be anything";
  EXPECT_EQ(DistanceToRange<SE3>(MakeDisplacement<4>(0.5, 2, 0.1), Vector<4>(1, 1, 1, kPi)), 0) << "all angles do";
}

TEST(RangeProbabilities, AnglesWrap) {
  const Vector<4> range(1, 1, 1, 3.0);
  // pi is 0.1416 beyond the range on either side.
  const auto at_pi = RangeProbabilities<SE3>(MakeDisplacement<4>(0, kPi, 0.1), range);
  EXPECT_NEAR(at_pi[3], 2 * NormalTail((kPi - 3.0) / 0.1), 1e-12);
  // 2 pi is 0 again.
  EXPECT_NEAR(RangeProbabilities<SE3>(MakeDisplacement<4>(0, 2 * kPi, 0.1), Vector<4>(1, 1, 1, 0.2))[3],
              1 - 2 * NormalTail(2), 1e-12);
  EXPECT_EQ(RangeProbabilities<SE3>(MakeDisplacement<4>(0, kPi, 0.1), Vector<4>(1, 1, 1, kPi))[3], 1);
  // Nothing is known of the angle: every direction is as likely.
  for (const double sigma : {4.0, 6.2, 6.4, 30.0, 1e6}) {
    // A wrapped normal is uniform to 2 exp(-sigma^2 / 2).
    EXPECT_NEAR(RangeProbabilities<SE3>(MakeDisplacement<4>(0, 1, sigma), Vector<4>(1, 1, 1, 1))[3], 1 / kPi,
                2 * std::exp(-sigma * sigma / 2) + 1e-8);
  }
}

TEST(RangeProbabilities, BothSidesAreEquallyPrecise) {
  for (const double beyond : {1.0, 5.0, 10.0, 20.0}) {
    for (const double side : {-1.0, 1.0}) {
      const auto p = RangeProbabilities<SE2>(MakeDisplacement<3>(side * (1 + beyond), side * (0.5 + beyond / 20), 1),
                                             Vector<3>(1, 1, 0.5));
      EXPECT_NEAR(p[0] / (NormalTail(beyond) - NormalTail(beyond + 2)), 1, 1e-9) << beyond;
    }
  }
}

TEST(RangeProbabilities, CertainDisplacementsAreInOrOut) {
  const Vector<3> range(1, 1, 0.5);
  EXPECT_EQ(RangeProbabilities<SE2>(MakeDisplacement<3>(1, 0.5, 0), range), Vector<3>(1, 1, 1));
  EXPECT_EQ(RangeProbabilities<SE2>(MakeDisplacement<3>(1.1, -0.6, 0), range), Vector<3>(0, 0, 0));
}

TEST(DeviationsBeyondRange, IsTheNormalTail) {
  EXPECT_NEAR(DeviationsBeyondRange(0.1), 1.2815515655446004, 1e-12);
  EXPECT_NEAR(DeviationsBeyondRange(0.025), 1.959963984540054, 1e-12);
  for (double p = 0.49; p > 1e-200; p *= 0.3) EXPECT_NEAR(NormalTail(DeviationsBeyondRange(p)) / p, 1, 1e-9);
  for (const double p : {0.5, 0.7, 0.999}) EXPECT_EQ(DeviationsBeyondRange(p), 0);
  EXPECT_EQ(NormalTail(DeviationsBeyondRange(0)), 0) << "beyond what a double holds";
}

// What the prefilter relies on: a mean farther out than that has no probability above the threshold.
TEST(DeviationsBeyondRange, BoundsTheProbability) {
  Random rng(8);
  for (int trial = 0; trial < 5000; ++trial) {
    const double threshold = trial % 2 == 0 ? 0.1 : Uniform(rng, 0, 0.9);
    const double sigma = std::exp(Uniform(rng, -5, 3)), range = std::exp(Uniform(rng, -3, 3));
    const double mean = range + sigma * (DeviationsBeyondRange(threshold) + Uniform(rng, 0, 2));
    const double side = rng() % 2 == 0 ? 1 : -1;
    const auto p = RangeProbabilities<SE2>(MakeDisplacement<3>(side * mean, 0, sigma), Vector<3>::Constant(range));
    EXPECT_LE(p[0], threshold + 1e-12);
  }
}

}  // namespace
}  // namespace terse
