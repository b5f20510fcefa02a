// Batch optimisation: recovers the truth, ends where the gradient vanishes, reports failure.

#include "terse/core/batch_solver.h"

#include <gtest/gtest.h>

#include <random>
#include <string_view>

#include "terse/core/error.h"
#include "testing.h"

namespace terse {
namespace {

using testing::Random;

template <class Pose>
std::vector<Pose> Values(const PoseGraph<Pose>& graph) {
  std::vector<Pose> out;
  for (const auto& node : graph.Poses()) out.push_back(*node.T_world_body);
  return out;
}

template <class Pose>
class BatchSolverTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(BatchSolverTest, Groups);

TYPED_TEST(BatchSolverTest, RecoversTheTruthWithoutNoise) {
  Random rng(1);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {40, 0.5, 0.0});
  std::vector<TypeParam> initial = random.truth;
  for (std::size_t i = 1; i < initial.size(); ++i) {
    initial[i] = initial[i] * testing::RandomMotion<TypeParam>(rng, 0.2, 0.1);
  }
  const auto result = SolveBatch(random.graph, initial);
  ASSERT_TRUE(result.Converged()) << result.message;
  EXPECT_LT(result.chi2, 1e-12);
  for (std::size_t i = 0; i < initial.size(); ++i) {
    // The gradient is flat to rounding: poses are good to the square root of the tolerance over the weights.
    EXPECT_LT(random.truth[i].Local(result.T_world_body[i]).norm(), 1e-7);
  }
}

// However a run ended: after steps that climbed, were rejected or damped, or that there were no more of.
TYPED_TEST(BatchSolverTest, TheFactorIsThatOfTheFinalValues) {
  int unfinished = 0, damped = 0;
  for (const std::uint64_t seed : {11U, 12U, 13U, 14U}) {
    Random rng(seed);
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, {60, 0.1, 0.2});
    std::vector<TypeParam> initial = random.truth;
    for (std::size_t i = 1; i < initial.size(); ++i) {
      initial[i] = initial[i] * testing::RandomMotion<TypeParam>(rng, 30, 3.1);
    }
    for (int most = 1; most <= 14; ++most) {
      BatchOptions options;
      options.max_iterations = most;
      options.log = [&](LogLevel, std::string_view text) {
        damped += text.find("damped steps from there") != text.npos || text.find("rejected") != text.npos;
      };
      const auto result = SolveBatch(random.graph, initial, options);
      unfinished += !result.Converged();
      const auto expected = CholeskyAt(random.graph, result.T_world_body);
      EXPECT_NEAR(result.log_determinant, expected.LogDeterminant(), 1e-9 * std::abs(expected.LogDeterminant()));
      EXPECT_NEAR(result.cholesky.NewtonDecrement(), expected.NewtonDecrement(),
                  1e-7 * (expected.NewtonDecrement() + 1e-6 * result.chi2));
      EXPECT_NEAR(result.chi2, Chi2(random.graph.WithPoses(result.T_world_body)), 1e-9 * result.chi2);
    }
  }
  EXPECT_GT(unfinished, 10);
  EXPECT_GT(damped, 0);
}

TYPED_TEST(BatchSolverTest, EndsWhereTheGradientVanishes) {
  for (const bool priors : {false, true}) {
    Random rng(priors ? 2 : 3);
    testing::RandomGraphOptions options;
    options.poses = 50;
    options.priors = priors;
    options.id_stride = 7;
    const auto random = testing::MakeRandomGraph<TypeParam>(rng, options);
    for (const Method method : {Method::kGaussNewton, Method::kLevenbergMarquardt}) {
      BatchOptions batch;
      batch.method = method;
      const auto result = SolveBatch(random.graph, Values(random.graph), batch);
      ASSERT_TRUE(result.Converged()) << result.message;
      const auto dense = testing::MakeDenseSystem(random.graph, result.T_world_body);
      EXPECT_NEAR(result.gradient_norm, dense.b.cwiseAbs().maxCoeff(), 1e-6);
      // The step that is left, in standard deviations.
      EXPECT_LT(std::sqrt(dense.b.dot(testing::Solve(dense.H, dense.b).col(0))), 1e-4);
      EXPECT_NEAR(result.chi2, Chi2(random.graph.WithPoses(result.T_world_body)), 1e-9 * result.chi2);
    }
  }
}

TYPED_TEST(BatchSolverTest, TellsHowFarAFactorisationIs) {
  Random rng(6);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {600, 0.5, 0.1});
  BatchOptions options;
  options.threads = 3;
  std::vector<double> shares;
  int steps = 0;
  options.factor_progress = [&](double share) { shares.push_back(share); };
  options.progress = [&](int, double) {
    ++steps;
    return true;
  };
  const auto result = SolveBatch(random.graph, Values(random.graph), options);
  ASSERT_TRUE(result.Converged()) << result.message;
  // Each factorisation rises to all of its work.
  int whole = 0;
  for (std::size_t k = 0; k < shares.size(); ++k) {
    EXPECT_GT(shares[k], 0);
    EXPECT_LT(shares[k], 1 + 1e-9);
    const bool is_last = k + 1 == shares.size() || shares[k + 1] < shares[k];
    if (is_last) {
      EXPECT_NEAR(shares[k], 1, 1e-9);
    }
    whole += is_last;
  }
  EXPECT_GE(whole, steps);
  EXPECT_GT(shares.size(), 10u * static_cast<std::size_t>(whole));
}

TYPED_TEST(BatchSolverTest, DampingSavesABadStart) {
  Random rng(4);
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, {60, 1.0, 0.01});
  std::vector<TypeParam> initial = random.truth;
  for (std::size_t i = 1; i < initial.size(); ++i) {
    initial[i] = initial[i] * testing::RandomMotion<TypeParam>(rng, 1.5, 0.5);
  }
  const auto best = SolveBatch(random.graph, random.truth);
  const auto result = SolveBatch(random.graph, initial);
  ASSERT_TRUE(result.Converged()) << result.message;
  EXPECT_NEAR(result.chi2, best.chi2, 1e-6 * best.chi2);
}

TYPED_TEST(BatchSolverTest, FixedPosesStayAndAreNotCounted) {
  Random rng(6);
  auto random = testing::MakeRandomGraph<TypeParam>(rng, {20, 0.5, 0.02});
  const PoseId first = random.graph.Poses().front().id, last = random.graph.Poses().back().id;
  random.graph.SetFixed(first, true);
  random.graph.SetFixed(last, true);
  const auto initial = Values(random.graph);
  const auto result = SolveBatch(random.graph, initial);
  ASSERT_TRUE(result.Converged()) << result.message;
  // Information 1e8 against about 1e2: the measurements pull by less than a micrometre times their residual.
  EXPECT_LT(initial.front().Local(result.T_world_body.front()).norm(), 1e-5);
  EXPECT_LT(initial.back().Local(result.T_world_body.back()).norm(), 1e-5);
}

TYPED_TEST(BatchSolverTest, ReportsASingularSystem) {
  PoseGraph<TypeParam> graph;
  graph.AddPose(PoseId{3}, TypeParam());
  graph.AddPose(PoseId{8}, TypeParam());
  const auto result = SolveBatch(graph, Values(graph));
  EXPECT_EQ(result.termination, Termination::kNotPositiveDefinite);
  EXPECT_NE(result.message.find("pose 8"), std::string::npos) << result.message;
  EXPECT_THROW(CholeskyAt(graph, Values(graph)), NumericalError);
}

TYPED_TEST(BatchSolverTest, RefusesMisuse) {
  PoseGraph<TypeParam> graph;
  EXPECT_THROW(SolveBatch(graph, std::vector<TypeParam>()), std::invalid_argument);
  graph.AddPose(PoseId{0});
  EXPECT_THROW(SolveBatch(graph, std::vector<TypeParam>()), std::invalid_argument);
}

// A chain whose loops contradict it by far.
int IterationsOfAContradiction(double translation, double rotation, int loops, unsigned seed) {
  constexpr int kPoses = 100;
  std::mt19937 engine(seed);
  std::normal_distribution<double> normal;
  std::uniform_int_distribution<int> any(0, kPoses - 1);
  const Vector<3> deviations(translation, translation, rotation);
  const Matrix<3, 3> information = deviations.cwiseAbs2().cwiseInverse().asDiagonal();
  PoseGraph<SE2> graph;
  std::vector<SE2> start{SE2()};
  graph.AddPose({0});
  for (int k = 1; k < kPoses; ++k) {
    const double theta = (k % 20 == 0 ? 1.57 : 0) + rotation * normal(engine);
    const double x = 1 + translation * normal(engine), y = translation * normal(engine);
    const SE2 T({x, y}, theta);
    graph.AddPose({k});
    graph.AddFactor(RelativePoseFactor<SE2>{{k - 1}, {k}, T, information});
    start.push_back(start.back() * T);
  }
  for (int k = 0; k < loops; ++k) {
    const int a = any(engine), b = any(engine);
    if (a == b) continue;
    const double theta = normal(engine), x = 3 * normal(engine), y = 3 * normal(engine);
    graph.AddFactor(RelativePoseFactor<SE2>{{a}, {b}, SE2({x, y}, theta), information});
  }
  BatchOptions options;
  options.max_iterations = 1000;
  return SolveBatch(graph, start, options).iterations;
}

// Where the cost is at rest damping must not grow on what rounding says of it, until there is no iteration left.
TEST(BatchSolver, ComesToRest) {
  EXPECT_LT(IterationsOfAContradiction(0.001, 0.01, 5, 18), 300);
  EXPECT_LT(IterationsOfAContradiction(0.01, 0.01, 5, 15), 300);
  EXPECT_LT(IterationsOfAContradiction(0.01, 0.05, 5, 4), 300);
  EXPECT_LT(IterationsOfAContradiction(0.1, 0.05, 5, 28), 300);
  EXPECT_LT(IterationsOfAContradiction(0.1, 0.05, 20, 24), 300);
  EXPECT_LT(IterationsOfAContradiction(0.1, 0.2, 20, 6), 300);
}

}  // namespace
}  // namespace terse
