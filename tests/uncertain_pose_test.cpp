// Composition of uncertain poses, and the information a link adds.

#include "terse/compact/uncertain_pose.h"

#include <gtest/gtest.h>

#include "terse/compact/information.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/marginals.h"
#include "testing.h"
#include "testing_jacobian.h"

namespace terse {
namespace {

using testing::NormalVector;
using testing::Random;
using testing::RelativeError;

template <class Pose>
UncertainPose<Pose> RandomUncertain(Random& rng, double scale = 0.1) {
  return {testing::RandomMotion<Pose>(rng, 2, 1), testing::RandomInformation<Pose::kDof>(rng, scale * scale)};
}

// Rounding over a few products of 6x6 matrices with entries up to some tens.
constexpr double kRounding = 1e-10;

template <class Pose>
void ExpectEqual(const UncertainPose<Pose>& actual, const UncertainPose<Pose>& expected) {
  EXPECT_LT((actual.T_a_b.Inverse() * expected.T_a_b).Log().norm(), kRounding);
  EXPECT_LT(RelativeError(actual.covariance, expected.covariance), kRounding);
  EXPECT_EQ(actual.covariance, actual.covariance.transpose());
}

template <class Pose>
class UncertainPoseTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(UncertainPoseTest, Groups);

TYPED_TEST(UncertainPoseTest, GroupLaws) {
  using Pose = TypeParam;
  Random rng(1);
  for (int trial = 0; trial < 100; ++trial) {
    const auto a = RandomUncertain<Pose>(rng), b = RandomUncertain<Pose>(rng), c = RandomUncertain<Pose>(rng);
    ExpectEqual(Compose(Compose(a, b), c), Compose(a, Compose(b, c)));
    ExpectEqual(Compose(a, UncertainPose<Pose>{}), a);
    ExpectEqual(Compose(UncertainPose<Pose>{}, a), a);
    ExpectEqual(Invert(Invert(a)), a);
    ExpectEqual(Invert(Compose(a, b)), Compose(Invert(b), Invert(a)));
    EXPECT_LT(Compose(a, Invert(a)).T_a_b.Log().norm(), kRounding);
  }
}

TYPED_TEST(UncertainPoseTest, CovariancesAreThoseOfTheNumericalJacobians) {
  using Pose = TypeParam;
  using Tangent = typename Pose::Tangent;
  Random rng(2);
  for (int trial = 0; trial < 30; ++trial) {
    const auto a = RandomUncertain<Pose>(rng), b = RandomUncertain<Pose>(rng);
    const Pose mean = a.T_a_b * b.T_a_b;
    const auto first = [&](const Tangent& d) -> Tangent { return mean.Local(a.T_a_b.Retract(d) * b.T_a_b); };
    const auto second = [&](const Tangent& d) -> Tangent { return mean.Local(a.T_a_b * b.T_a_b.Retract(d)); };
    const auto inverse = [&](const Tangent& d) -> Tangent {
      return a.T_a_b.Inverse().Local(a.T_a_b.Retract(d).Inverse());
    };
    const auto spread = [&](const auto& f, const auto& Sigma) -> typename Pose::Jacobian {
      const auto J = testing::CentralDifferences<Pose::kDof>(f, 1e-5);
      return J * Sigma * J.transpose();
    };
    // Differences are good to about 1e-10.
    const typename Pose::Jacobian sum = spread(first, a.covariance) + spread(second, b.covariance);
    EXPECT_LT(RelativeError(Compose(a, b).covariance, sum), 1e-8);
    EXPECT_LT(RelativeError(Invert(a).covariance, spread(inverse, a.covariance)), 1e-8);
  }
}

TYPED_TEST(UncertainPoseTest, ComposedCovarianceMatchesSampling) {
  using Pose = TypeParam;
  constexpr int N = Pose::kDof, kSamples = 100000;
  Random rng(3);
  const auto a = RandomUncertain<Pose>(rng, 0.005), b = RandomUncertain<Pose>(rng, 0.005);
  const auto ab = Compose(a, b);
  const typename Pose::Jacobian La = testing::CholeskyFactor(a.covariance), Lb = testing::CholeskyFactor(b.covariance);
  Matrix<N, N> covariance = Matrix<N, N>::Zero();
  for (int s = 0; s < kSamples; ++s) {
    const typename Pose::Tangent da = La * NormalVector<N>(rng), db = Lb * NormalVector<N>(rng);
    const typename Pose::Tangent e = ab.T_a_b.Local(a.T_a_b.Retract(da) * b.T_a_b.Retract(db));
    covariance += e * e.transpose() / kSamples;
  }
  // 5 sqrt(2 / 1e5) = 0.022 of sampling, and the second order.
  for (int i = 0; i < N; ++i) {
    for (int j = 0; j < N; ++j) {
      EXPECT_NEAR(covariance(i, j), ab.covariance(i, j), 0.03 * std::sqrt(ab.covariance(i, i) * ab.covariance(j, j)));
    }
  }
}

template <int N>
Vector<N> Sample(const Matrix<N, N>& covariance, Random& rng) {
  const Matrix<N, N> L = testing::CholeskyFactor(covariance);
  return L * NormalVector<N>(rng);
}

// Rotations that move far by turning, and errors of some tenths of a radian in all directions.
template <class Pose>
UncertainPose<Pose> FarAndUncertain(Random& rng, double radians) {
  constexpr int N = Pose::kDof;
  auto out = RandomUncertain<Pose>(rng, radians);
  const Vector<N> unit = Vector<N>::Ones() + NormalVector<N>(rng).cwiseAbs();
  const Vector<N> scale = (radians * unit).cwiseQuotient(out.covariance.diagonal().cwiseSqrt());
  out.covariance = scale.asDiagonal() * out.covariance * scale.asDiagonal();
  out.covariance = (out.covariance + out.covariance.transpose()).eval() / 2;
  return out;
}

// Relative to the truth: all eigenvalues are one if they agree.
template <int N>
Eigen::VectorXd RelativeEigenvalues(const Matrix<N, N>& covariance, const Matrix<N, N>& truth) {
  return testing::Eigenvalues(covariance, truth);
}

TYPED_TEST(UncertainPoseTest, FourthOrderIsCloserToSamples) {
  using Pose = TypeParam;
  constexpr int N = Pose::kDof, kSamples = 100000;
  Random rng(11);
  for (const double radians : {0.1, 0.2, 0.25}) {
    const auto a = FarAndUncertain<Pose>(rng, radians), b = FarAndUncertain<Pose>(rng, radians);
    const auto first = Compose(a, b), fourth = Compose(a, b, CompositionOrder::kFourth);
    EXPECT_EQ((first.T_a_b.Inverse() * fourth.T_a_b).Log(), Pose().Log());
    Matrix<N, N> sampled = Matrix<N, N>::Zero();
    for (int s = 0; s < kSamples; ++s) {
      const Pose moved =
          a.T_a_b * Pose::Exp(Sample<N>(a.covariance, rng)) * b.T_a_b * Pose::Exp(Sample<N>(b.covariance, rng));
      const Vector<N> e = (first.T_a_b.Inverse() * moved).Log();
      sampled += e * e.transpose() / kSamples;
    }
    const auto off_first = RelativeEigenvalues<N>(first.covariance, sampled),
               off_fourth = RelativeEigenvalues<N>(fourth.covariance, sampled);
    const double error_first = (off_first.array() - 1).abs().maxCoeff(),
                 error_fourth = (off_fourth.array() - 1).abs().maxCoeff();
    // Sampling leaves about 2 sqrt(6 / 1e5) = 0.015.
    EXPECT_LT(error_fourth, error_first / 2 + 0.015) << radians;
    EXPECT_GT(off_fourth.minCoeff(), std::max(off_first.minCoeff(), 0.95)) << "where the first order is too small";
  }
}

TYPED_TEST(UncertainPoseTest, FourthOrderTendsToTheFirst) {
  using Pose = TypeParam;
  Random rng(12);
  for (int trial = 0; trial < 20; ++trial) {
    auto a = RandomUncertain<Pose>(rng, 1), b = RandomUncertain<Pose>(rng, 1);
    const auto difference = [&](double scale) {
      auto x = a, y = b;
      x.covariance *= scale * scale, y.covariance *= scale * scale;
      return RelativeError(Compose(x, y, CompositionOrder::kFourth).covariance, Compose(x, y).covariance);
    };
    // Relative to the first order, the fourth is of second order.
    EXPECT_LT(difference(1e-4), 1e-4);
    EXPECT_NEAR(difference(1e-3) / difference(1e-4), 100, 1);
    for (const auto order : {CompositionOrder::kFirst, CompositionOrder::kFourth}) {
      ExpectEqual(Compose(a, UncertainPose<Pose>{}, order), a);
      ExpectEqual(Compose(UncertainPose<Pose>{}, a, order), a);
    }
    b.covariance.setZero();
    EXPECT_EQ(Compose(a, b, CompositionOrder::kFourth).covariance, Compose(a, b).covariance) << "an exact pose";
  }
}

TYPED_TEST(UncertainPoseTest, FourthOrderIsAssociativeToSixth) {
  using Pose = TypeParam;
  constexpr auto kFourth = CompositionOrder::kFourth;
  Random rng(13);
  for (int trial = 0; trial < 20; ++trial) {
    const auto a = RandomUncertain<Pose>(rng, 1), b = RandomUncertain<Pose>(rng, 1), c = RandomUncertain<Pose>(rng, 1);
    const auto difference = [&](double scale) {
      auto x = a, y = b, z = c;
      x.covariance *= scale * scale, y.covariance *= scale * scale, z.covariance *= scale * scale;
      const auto left = Compose(Compose(x, y, kFourth), z, kFourth),
                 right = Compose(x, Compose(y, z, kFourth), kFourth);
      return RelativeError(left.covariance, right.covariance);
    };
    const double ratio = difference(0.02) / difference(0.01);
    EXPECT_NEAR(ratio, 16, 1) << "fourth order relative to the covariance";
  }
}

TYPED_TEST(UncertainPoseTest, CompositionIsAlwaysACovariance) {
  using Pose = TypeParam;
  constexpr int N = Pose::kDof;
  Random rng(14);
  for (int trial = 0; trial < 300; ++trial) {
    auto a = RandomUncertain<Pose>(rng, std::pow(10, trial % 6 - 4)),
         b = RandomUncertain<Pose>(rng, std::pow(10, trial % 5 - 3));
    if (trial % 3 == 0) {  // singular ones
      const Vector<N> u = NormalVector<N>(rng);
      a.covariance = u * u.transpose();
    }
    if (trial % 7 == 0) b.covariance.setZero();
    for (const auto order : {CompositionOrder::kFirst, CompositionOrder::kFourth}) {
      auto chain = Compose(a, b, order);
      for (int k = 0; k < 3; ++k) chain = Compose(chain, b, order);
      for (const Matrix<N, N>& Sigma : {chain.covariance, RetractCovariance(chain)}) {
        ASSERT_TRUE(Sigma.allFinite());
        EXPECT_EQ(Sigma, Sigma.transpose());
        const Eigen::VectorXd values = testing::Eigenvalues(Sigma);
        EXPECT_GE(values[0], -1e-12 * values[N - 1]);
      }
    }
  }
}

// A robot drives straight for 40 m and hardly knows its heading: the end lies on an arc.
TYPED_TEST(UncertainPoseTest, LongChainMatchesSampling) {
  using Pose = TypeParam;
  constexpr int N = Pose::kDof, kSteps = 40, kSamples = 20000;
  typename Pose::Tangent forward = Pose::Tangent::Zero();
  forward[0] = 1;
  UncertainPose<Pose> step{Pose::Exp(forward)};
  step.covariance.diagonal().setConstant(4e-4);
  step.covariance.diagonal().template tail<N - Pose::kDim>().setConstant(2.5e-3);
  UncertainPose<Pose> first, fourth;
  for (int k = 0; k < kSteps; ++k) {
    first = Compose(first, step);
    fourth = Compose(fourth, step, CompositionOrder::kFourth);
  }
  Random rng(15);
  Matrix<N, N> sampled = Matrix<N, N>::Zero(), in_chart = Matrix<N, N>::Zero();
  for (int s = 0; s < kSamples; ++s) {
    Pose moved;
    for (int k = 0; k < kSteps; ++k) moved = moved * step.T_a_b * Pose::Exp(Sample<N>(step.covariance, rng));
    const Vector<N> e = (first.T_a_b.Inverse() * moved).Log(), r = first.T_a_b.Local(moved);
    sampled += e * e.transpose() / kSamples;
    in_chart += r * r.transpose() / kSamples;
  }
  const auto off_first = RelativeEigenvalues<N>(first.covariance, sampled),
             off_fourth = RelativeEigenvalues<N>(fourth.covariance, sampled),
             off_chart_first = RelativeEigenvalues<N>(first.covariance, in_chart),
             off_chart = RelativeEigenvalues<N>(RetractCovariance(fourth), in_chart);
  // The chord shortens by the square of the heading's error, of which the first order knows nothing. Sampling leaves
  // about 2 sqrt(6 / 2e4) = 0.035.
  EXPECT_LT(off_first.minCoeff(), 0.1);
  EXPECT_LT(off_chart_first.minCoeff(), 0.1);
  EXPECT_GT(off_fourth.minCoeff(), 0.9);
  EXPECT_LT(off_fourth.maxCoeff(), 1.1);
  EXPECT_GT(off_chart.minCoeff(), 0.9);
  EXPECT_LT(off_chart.maxCoeff(), 2);
}

TYPED_TEST(UncertainPoseTest, SeenFromEitherEnd) {
  using Pose = TypeParam;
  Random rng(4);
  const RelativePoseFactor<Pose> edge{PoseId{7}, PoseId{-3}, testing::RandomMotion<Pose>(rng, 2, 1),
                                      testing::RandomInformation<Pose::kDof>(rng, 100)};
  const auto forward = SeenFrom(PoseId{7}, edge), backward = SeenFrom(PoseId{-3}, edge);
  ExpectEqual(forward, {edge.T_from_to, testing::Inverse(edge.information)});
  ExpectEqual(backward, Invert(forward));
  EXPECT_THROW((void)SeenFrom(PoseId{8}, edge), std::invalid_argument);
}

template <int B>
double DenseGain(const Matrix<B, B>& Sigma_d, const Matrix<B, B>& Sigma_y) {
  const Matrix<B, B> sum = Sigma_y + Sigma_d;
  return (testing::LogDeterminant(sum) - testing::LogDeterminant(Sigma_y)) / 2;
}

TYPED_TEST(UncertainPoseTest, GainIsTheDifferenceOfLogDeterminants) {
  constexpr int B = TypeParam::kDof;
  Random rng(5);
  for (int trial = 0; trial < 100; ++trial) {
    const Matrix<B, B> d = testing::RandomInformation<B>(rng, std::pow(10, trial % 5 - 2)),
                       y = testing::RandomInformation<B>(rng);
    const double gain = InformationGain<B>(d, y);
    EXPECT_NEAR(gain, DenseGain<B>(d, y), 1e-11 * (1 + gain));
    EXPECT_GT(gain, 0);
    EXPECT_GT(InformationGain<B>(2 * d, y), gain);
    EXPECT_LT(InformationGain<B>(d, 2 * y), gain);
    EXPECT_NEAR(InformationGain<B>(Matrix<B, B>::Zero(), y), 0, 1e-15);
    // Either pose of the link may be the one seen from.
    const UncertainPose<TypeParam> u{testing::RandomMotion<TypeParam>(rng, 2, 1), d}, v{u.T_a_b, y};
    EXPECT_NEAR(InformationGain<B>(Invert(u).covariance, Invert(v).covariance), gain, 1e-9 * (1 + gain));
  }
}

// The gain foretold is what the log-determinant of the system grows by when the link is added.
TYPED_TEST(UncertainPoseTest, GainIsWhatTheGraphGains) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  for (const std::uint64_t seed : testing::Seeds(1, 12)) {
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 12;
    options.priors = seed % 3 == 0;
    options.id_stride = 3;
    auto random = testing::MakeRandomGraph<Pose>(rng, options);
    const auto& poses = random.graph.Poses();
    const Marginals<Pose> marginals(random.graph, random.truth);
    const std::size_t i = rng() % 11, j = i + 1 + rng() % (11 - i);
    const PoseId from = seed % 2 == 0 ? poses[i].id : poses[j].id, to = seed % 2 == 0 ? poses[j].id : poses[i].id;
    const auto value = [&](PoseId id) { return random.truth[static_cast<std::size_t>(random.graph.IndexOf(id))]; };
    const RelativePoseFactor<Pose> link{from, to, value(from).Inverse() * value(to),
                                        testing::RandomInformation<B>(rng, 50)};
    const double gain =
        InformationGain<B>(marginals.Relative(poses[i].id, poses[j].id), SeenFrom(poses[i].id, link).covariance);

    const auto half_log_det = [&](const PoseGraph<Pose>& graph) {
      return testing::LogDeterminant(testing::MakeDenseSystem(graph, random.truth).H) / 2;
    };
    PoseGraph<Pose> with_link = random.graph;
    with_link.AddFactor(link);
    // The anchor's 1e8 costs eight digits of the covariances of poses near it.
    EXPECT_NEAR(gain, half_log_det(with_link) - half_log_det(random.graph), 1e-7 * (1 + gain)) << "seed " << seed;

    IncrementalOptions never_relinearise;
    never_relinearise.relinearize_metres = never_relinearise.relinearize_radians = 1e9;
    IncrementalSolver<Pose> solver(never_relinearise);
    GraphUpdate<Pose> first;
    for (std::size_t k = 0; k < poses.size(); ++k) first.poses.push_back({poses[k].id, random.truth[k], false});
    for (const auto& node : random.graph.Factors()) first.factors.push_back(node.factor);
    solver.Update(first);
    const double before = solver.LogDeterminant();
    GraphUpdate<Pose> second;
    second.factors.push_back(link);
    solver.Update(second);
    // Priors move the map as a whole to where they say, and its points with it.
    const Marginals<Pose> there(random.graph, solver.LinearizationPoints());
    const double gain_there =
        InformationGain<B>(there.Relative(poses[i].id, poses[j].id), SeenFrom(poses[i].id, link).covariance);
    EXPECT_NEAR(gain_there, (solver.LogDeterminant() - before) / 2, 1e-7 * (1 + gain)) << "seed " << seed;
  }
}

}  // namespace
}  // namespace terse
