// Covariances out of the factor against the dense inverse.

#include "terse/covariance/marginals.h"

#include <gtest/gtest.h>

#include "terse/core/batch_solver.h"
#include "terse/core/error.h"
#include "terse/core/incremental_solver.h"
#include "testing.h"

namespace terse {
namespace {

using testing::Random;
using testing::RelativeError;

template <class Pose>
class MarginalsTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(MarginalsTest, Groups);

template <class Pose>
Eigen::MatrixXd DenseCovariance(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
  return testing::Inverse(testing::MakeDenseSystem(graph, values).H);
}

TYPED_TEST(MarginalsTest, EveryBlockEqualsTheDenseInverse) {
  constexpr int B = TypeParam::kDof;
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 5 + static_cast<int>(seed) * 6;
    options.loops_per_pose = seed % 2 == 0 ? 1.0 : 0.3;
    options.priors = seed % 3 == 0;
    options.id_stride = 11;
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, options);
    const Eigen::MatrixXd Sigma = DenseCovariance(random.graph, random.truth);
    const Marginals<TypeParam> marginals(random.graph, random.truth);
    const auto block = [&](std::size_t i, std::size_t j) {
      return Sigma.block<B, B>(static_cast<Eigen::Index>(i) * B, static_cast<Eigen::Index>(j) * B);
    };
    const auto& poses = random.graph.Poses();
    const auto all = marginals.AllMarginals();
    // The first pose's covariance is tiny beside the rest (the anchor): errors are measured against the whole.
    const double scale = Sigma.norm() / static_cast<double>(poses.size());
    for (std::size_t i = 0; i < poses.size(); ++i) {
      ASSERT_LT((all[i] - block(i, i)).norm(), 1e-9 * std::max(block(i, i).norm(), 1e-3 * scale));
      ASSERT_LT((marginals.Marginal(poses[i].id) - block(i, i)).norm(),
                1e-9 * std::max(block(i, i).norm(), 1e-3 * scale));
      for (std::size_t j = 0; j < poses.size(); ++j) {
        ASSERT_LT((marginals.Cross(poses[i].id, poses[j].id) - block(i, j)).norm(), 1e-9 * scale);
      }
    }
    std::vector<PoseId> ids;
    std::vector<std::size_t> chosen;
    for (std::size_t i = poses.size(); i-- > 0;) {
      if (rng() % 3 == 0) chosen.push_back(i);
    }
    if (chosen.empty()) chosen.push_back(0);
    Eigen::MatrixXd expected(static_cast<Eigen::Index>(chosen.size()) * B,
                             static_cast<Eigen::Index>(chosen.size()) * B);
    for (std::size_t r = 0; r < chosen.size(); ++r) {
      ids.push_back(poses[chosen[r]].id);
      for (std::size_t c = 0; c < chosen.size(); ++c) {
        expected.block<B, B>(static_cast<Eigen::Index>(r) * B, static_cast<Eigen::Index>(c) * B) =
            block(chosen[r], chosen[c]);
      }
    }
    ASSERT_LT(RelativeError(marginals.Joint(ids), expected), 1e-9);
  }
}

// The relative covariance a second, independent way: a numerical derivative of T_a^-1 T_b applied to the joint.
TYPED_TEST(MarginalsTest, RelativeEqualsPropagationByDifferences) {
  constexpr int B = TypeParam::kDof;
  Random rng(17);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {25, 0.7, 0.02});
  const Marginals<TypeParam> marginals(random.graph, random.truth);
  const auto& poses = random.graph.Poses();
  for (int trial = 0; trial < 20; ++trial) {
    const std::size_t i = rng() % poses.size(), j = rng() % poses.size();
    if (i == j) continue;
    const MatrixX joint = marginals.Joint({poses[i].id, poses[j].id});
    const TypeParam T_a = random.truth[i], T_b = random.truth[j], T_a_b = T_a.Inverse() * T_b;
    Matrix<B, 2 * B> J;
    for (int k = 0; k < 2 * B; ++k) {
      const auto moved = [&](double h) {
        Vector<2 * B> d = Vector<2 * B>::Zero();
        d[k] = h;
        const Vector<B> d_a = d.template head<B>(), d_b = d.template tail<B>();
        return T_a_b.Local(T_a.Retract(d_a).Inverse() * T_b.Retract(d_b));
      };
      J.col(k) = (moved(1e-6) - moved(-1e-6)) / 2e-6;
    }
    const Matrix<B, B> expected = J * joint * J.transpose();
    const auto body = marginals.Relative(poses[i].id, poses[j].id);
    // Central differences are good to about 1e-9; the joint is up to a hundred times its difference.
    EXPECT_LT(RelativeError(body, expected), 1e-5);
    EXPECT_TRUE(testing::IsPositiveDefinite(body));
    const auto world =
        marginals.Relative(poses[i].id, poses[j].id, {CovarianceFrame::kWorld, TangentOrder::kTranslationFirst});
    EXPECT_LT(RelativeError(world, T_a_b.Adjoint() * body * T_a_b.Adjoint().transpose()), 1e-12);
  }
}

TYPED_TEST(MarginalsTest, ConventionsAreWhatTheySay) {
  constexpr int B = TypeParam::kDof;
  constexpr int R = B - TypeParam::kDim;
  Random rng(23);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {10, 0.7, 0.02});
  const Marginals<TypeParam> marginals(random.graph, random.truth);
  const PoseId id = random.graph.Poses()[6].id;
  const auto body = marginals.Marginal(id);
  // World frame: Exp(e) T = T Exp(d).
  Matrix<B, B> J;
  const TypeParam T = random.truth[6];
  for (int k = 0; k < B; ++k) {
    Vector<B> d = Vector<B>::Zero();
    d[k] = 1e-6;
    const Vector<B> minus = -d;
    J.col(k) = ((T.Retract(d) * T.Inverse()).Log() - (T.Retract(minus) * T.Inverse()).Log()) / 2e-6;
  }
  const auto world = marginals.Marginal(id, {CovarianceFrame::kWorld, TangentOrder::kTranslationFirst});
  EXPECT_LT(RelativeError(world, J * body * J.transpose()), 1e-7);
  const auto swapped = marginals.Marginal(id, {CovarianceFrame::kBody, TangentOrder::kRotationFirst});
  EXPECT_EQ((swapped.template topLeftCorner<R, R>()), (body.template bottomRightCorner<R, R>()));
  EXPECT_EQ((swapped.template bottomRightCorner<TypeParam::kDim, TypeParam::kDim>()),
            (body.template topLeftCorner<TypeParam::kDim, TypeParam::kDim>()));
  EXPECT_EQ((swapped.template topRightCorner<R, TypeParam::kDim>()),
            (body.template bottomLeftCorner<R, TypeParam::kDim>()));
}

// A cached path must not outlive a change of the factor.
TYPED_TEST(MarginalsTest, SelectedInverseFollowsAnIncrementalFactor) {
  constexpr int B = TypeParam::kDof;
  Random rng(29);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {20, 0.8, 0.02});
  IncrementalSolver<TypeParam> solver;
  const SelectedInverse<B> inverse(solver.Cholesky());
  std::vector<GraphUpdate<TypeParam>> updates(20);
  for (int k = 0; k < 20; ++k)
    updates[static_cast<std::size_t>(k)].poses.push_back({random.graph.Poses()[static_cast<std::size_t>(k)].id});
  for (const auto& node : random.graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    updates[static_cast<std::size_t>(std::max(random.graph.IndexOf(ends.first), random.graph.IndexOf(ends.second)))]
        .factors.push_back(node.factor);
  }
  for (const auto& update : updates) {
    solver.Update(update);
    const Eigen::MatrixXd Sigma = DenseCovariance(solver.Graph(), solver.LinearizationPoints());
    for (int v = 1; v < solver.Cholesky().Variables(); ++v) {
      ASSERT_LT(RelativeError(inverse.Diagonal(v), Sigma.block<B, B>(v * B, v * B)), 1e-9);
    }
  }
}

// One call from a result: its own factor, with the weights of a robust kernel.
TYPED_TEST(MarginalsTest, OfAResult) {
  constexpr int B = TypeParam::kDof;
  Random rng(37);
  auto graph = testing::MakeRandomGraph<TypeParam>(rng, {30, 0.7, 0.02}).graph;
  const auto solved = SolveBatch(graph);
  ASSERT_TRUE(solved.Converged());
  const Marginals<TypeParam> marginals(graph, solved);
  const auto by_hand = Marginals<TypeParam>(graph, solved.T_world_body, solved.cholesky).AllMarginals();
  const auto all = marginals.AllMarginals();
  const Eigen::MatrixXd Sigma = DenseCovariance(graph, solved.T_world_body);
  for (std::size_t k = 0; k < all.size(); ++k) {
    EXPECT_EQ(all[k], by_hand[k]);
    const auto at = static_cast<Eigen::Index>(k) * B;
    if (k > 0) {
      EXPECT_LT(RelativeError(all[k], Sigma.block<B, B>(at, at)), 1e-7);
    }
  }

  const auto ids = graph.Poses();
  graph.AddFactor(RelativePoseFactor<TypeParam>{ids[3].id, ids[22].id, testing::RandomMotion<TypeParam>(rng, 5, 1),
                                                testing::RandomInformation<B>(rng, 100)});
  BatchOptions robust;
  robust.robust.kernel = RobustKernel::kGnc;
  auto rejected = SolveBatch(graph, robust);
  ASSERT_EQ(rejected.weights.back(), 0);
  const Eigen::MatrixXd Sigma_rejected = DenseCovariance(WithWeights(graph, rejected.weights), rejected.T_world_body);
  const PoseId last = ids.back().id;
  const Marginals<TypeParam> weighted(graph, std::move(rejected));
  EXPECT_LT(RelativeError(weighted.Marginal(last), Sigma_rejected.template bottomRightCorner<B, B>()), 1e-7);
}

TYPED_TEST(MarginalsTest, OfASingularResultSaysWhatIsFree) {
  PoseGraph<TypeParam> loose;
  loose.AddPose(PoseId{0}, TypeParam());
  loose.AddPose(PoseId{1}, TypeParam());
  PositionPriorFactor<TypeParam> prior;
  prior.pose = PoseId{1};
  prior.information.setIdentity();
  loose.AddFactor(prior);
  const auto result = SolveBatch(loose, std::vector<TypeParam>(2));
  ASSERT_EQ(result.termination, Termination::kNotPositiveDefinite);
  EXPECT_THROW(Marginals<TypeParam>(loose, result), UnobservableError);
}

TYPED_TEST(MarginalsTest, Refuses) {
  Random rng(31);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {5, 0.0, 0.02});
  const Marginals<TypeParam> marginals(random.graph, random.truth);
  EXPECT_THROW(marginals.Marginal(PoseId{-1}), std::invalid_argument);
  EXPECT_THROW(marginals.Relative(PoseId{100}, PoseId{100}), std::invalid_argument);
  PoseGraph<TypeParam> loose;
  loose.AddPose(PoseId{0});
  loose.AddPose(PoseId{1});
  EXPECT_THROW(Marginals<TypeParam>(loose, std::vector<TypeParam>(2)), NumericalError);
}

}  // namespace
}  // namespace terse
