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
  const Eigen::MatrixXd La = Eigen::MatrixXd(a.covariance).llt().matrixL(),
                        Lb = Eigen::MatrixXd(b.covariance).llt().matrixL();
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

TYPED_TEST(UncertainPoseTest, SeenFromEitherEnd) {
  using Pose = TypeParam;
  Random rng(4);
  const RelativePoseFactor<Pose> edge{PoseId{7}, PoseId{-3}, testing::RandomMotion<Pose>(rng, 2, 1),
                                      testing::RandomInformation<Pose::kDof>(rng, 100)};
  const auto forward = SeenFrom(PoseId{7}, edge), backward = SeenFrom(PoseId{-3}, edge);
  ExpectEqual(forward, {edge.T_from_to, edge.information.inverse()});
  ExpectEqual(backward, Invert(forward));
  EXPECT_THROW((void)SeenFrom(PoseId{8}, edge), std::invalid_argument);
}

template <int B>
double DenseGain(const Matrix<B, B>& Sigma_d, const Matrix<B, B>& Sigma_y) {
  const Matrix<B, B> sum = Sigma_y + Sigma_d;
  return (std::log(sum.determinant()) - std::log(Sigma_y.determinant())) / 2;
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
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
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
      return Eigen::MatrixXd(testing::MakeDenseSystem(graph, random.truth).H.llt().matrixL())
          .diagonal()
          .array()
          .log()
          .sum();
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
    EXPECT_NEAR(gain, (solver.LogDeterminant() - before) / 2, 1e-7 * (1 + gain)) << "seed " << seed;
  }
}

}  // namespace
}  // namespace terse
