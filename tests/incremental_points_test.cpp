// Carry::kPoint: Gauss-Newton by parts, against batch and dense solutions.

#include <gtest/gtest.h>

#include <numeric>

#include "terse/core/incremental_solver.h"
#include "terse/core/paper_flops.h"
#include "testing_incremental.h"

namespace terse {
namespace {

using testing::OnePosePerUpdate;
using testing::Random;

template <class Pose>
class IncrementalPointsTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(IncrementalPointsTest, Groups);

IncrementalOptions Points() {
  IncrementalOptions options;
  options.carry = Carry::kPoint;
  options.gate = Gate::kAlways;
  options.propagation_tolerance = 0;
  options.step_metres = options.step_radians = 0;
  options.max_iterations = 20;
  return options;
}

template <class Pose>
testing::RandomGraph<Pose> MakeGraph(std::uint64_t seed, double noise = 0.03, int poses = 30) {
  Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.noise = noise;
  options.priors = seed % 2 == 0;
  options.id_stride = 3;
  return testing::MakeRandomGraph<Pose>(rng, options);
}

template <class Pose>
double LargestDistance(const std::vector<Pose>& a, const std::vector<Pose>& b) {
  double largest = 0;
  for (std::size_t k = 0; k < a.size(); ++k) largest = std::max(largest, a[k].Local(b[k]).norm());
  return largest;
}

TYPED_TEST(IncrementalPointsTest, WithoutThresholdsEveryStepEndsAtTheBatchOptimum) {
  for (const std::uint64_t seed : testing::Seeds(1, 4)) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto random = MakeGraph<TypeParam>(seed);
    IncrementalSolver<TypeParam> solver(Points());
    for (const auto& update : OnePosePerUpdate(random.graph)) {
      const StepReport report = solver.Update(update);
      EXPECT_TRUE(report.gate_open);
      EXPECT_GT(report.solve_flops, 0);
      const auto batch = SolveBatch(solver.Graph(), solver.Estimates());
      ASSERT_NEAR(solver.Chi2(), batch.chi2, 1e-9 * batch.chi2 + 1e-12);
      ASSERT_LT(LargestDistance(solver.Estimates(), solver.LinearizationPoints()), 1e-15);
    }
  }
}

TYPED_TEST(IncrementalPointsTest, FinishReachesTheBatchOptimumWhateverTheGateAndPolicy) {
  const auto random = MakeGraph<TypeParam>(5);
  const auto batch = SolveBatch(random.graph, random.truth);
  ASSERT_TRUE(batch.Converged());
  std::vector<IncrementalOptions> all;
  for (const Policy policy : {Policy::kGn1, Policy::kGni, Policy::kGniLcg, Policy::kGniIgg, Policy::kGniSpo,
                              Policy::kGniSpoLcg, Policy::kGniSpoIgg}) {
    all.push_back(PolicyOptions(policy));
  }
  for (const Gate gate : {Gate::kNewtonDecrement, Gate::kMutualInformation, Gate::kLogDeterminant, Gate::kLoopClosure,
                          Gate::kAlways, Gate::kNever}) {
    IncrementalOptions options = Points();
    options.gate = gate;
    options.gate_threshold = DefaultThreshold(gate);
    options.step_metres = options.step_radians = 1e-3;
    options.partial = true;
    all.push_back(options);
  }
  for (std::size_t k = 0; k < all.size(); ++k) {
    SCOPED_TRACE("options " + std::to_string(k));
    IncrementalSolver<TypeParam> solver(all[k]);
    for (const auto& update : OnePosePerUpdate(random.graph)) solver.Update(update);
    EXPECT_NEAR(solver.Finish().chi2, batch.chi2, 1e-8 * batch.chi2);
    EXPECT_NEAR(solver.Chi2(), batch.chi2, 1e-8 * batch.chi2);
  }
}

TYPED_TEST(IncrementalPointsTest, PartialWithTinyThresholdsEqualsFull) {
  for (const bool neighbours : {false, true}) {
    const auto random = MakeGraph<TypeParam>(7);
    IncrementalOptions options = Points();
    IncrementalSolver<TypeParam> full(options);
    options.step_metres = options.step_radians = 1e-11;
    options.partial = true;
    options.partial_neighbours = neighbours;
    IncrementalSolver<TypeParam> partial(options);
    for (const auto& update : OnePosePerUpdate(random.graph)) {
      full.Update(update);
      partial.Update(update);
      ASSERT_LT(LargestDistance(full.Estimates(), partial.Estimates()), 1e-7);
    }
  }
}

TYPED_TEST(IncrementalPointsTest, PartialMovesOnlyWhatExceedsTheTolerance) {
  const auto random = MakeGraph<TypeParam>(9, 0.03, 60);
  IncrementalOptions options = Points();
  options.partial = true;
  options.step_metres = 0.01;
  options.step_radians = 0.005;
  IncrementalSolver<TypeParam> solver(options);
  int moved = 0, steps = 0;
  for (const auto& update : OnePosePerUpdate(random.graph)) {
    const auto before = solver.Estimates();
    const StepReport report = solver.Update(update);
    int differ = 0;
    for (std::size_t k = 0; k < before.size(); ++k) {
      differ += before[k].Local(solver.EstimateAt(static_cast<int>(k))).norm() > 0 ? 1 : 0;
    }
    EXPECT_LE(differ, report.variables_moved);
    moved += report.variables_moved;
    steps += report.iterations > 0 ? static_cast<int>(before.size()) : 0;
  }
  EXPECT_GT(moved, 0);
  EXPECT_LT(moved, steps);
}

// The new pose takes its share of the full Gauss-Newton step, nothing else moves.
TYPED_TEST(IncrementalPointsTest, ClosedGateMovesOnlyTheNewPoses) {
  constexpr int B = TypeParam::kDof;
  const auto random = MakeGraph<TypeParam>(11);
  for (const bool partial : {false, true}) {
    IncrementalOptions options = Points();
    options.gate = Gate::kNever;
    options.max_iterations = 1;
    options.partial = partial;
    options.guard = false;
    IncrementalSolver<TypeParam> solver(options);
    for (const auto& update : OnePosePerUpdate(random.graph, true)) {
      const auto before = solver.Estimates();
      const StepReport report = solver.Update(update);
      EXPECT_FALSE(report.gate_open);
      EXPECT_EQ(report.variables_moved, report.iterations);
      const auto after = solver.Estimates();
      EXPECT_EQ(LargestDistance(before, after), 0);
      auto points = before;
      points.push_back(*update.poses.front().T_world_body);
      const auto dense = testing::MakeDenseSystem(solver.Graph(), points);
      const Eigen::VectorXd x = testing::Solve(dense.H, dense.b);
      const TypeParam expected = points.back().Retract(x.template tail<B>());
      EXPECT_LT(expected.Local(after.back()).norm(), 1e-6);
    }
  }
}

TYPED_TEST(IncrementalPointsTest, TheGuardNeverLetsChi2Rise) {
  int rises_without = 0;
  for (std::uint64_t seed = 20; seed <= 25; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    const auto random = MakeGraph<TypeParam>(seed, 0.5, 25);
    for (const bool guard : {true, false}) {
      for (const bool partial : {false, true}) {
        IncrementalOptions options = Points();
        options.guard = guard;
        options.partial = partial;
        options.step_metres = options.step_radians = 0.1;
        options.max_iterations = 1;
        IncrementalSolver<TypeParam> solver(options);
        for (const auto& update : OnePosePerUpdate(random.graph, true)) {
          const auto before = solver.Estimates();
          const Gauge<TypeParam> gauge = solver.CurrentGauge();
          const StepReport report = solver.Update(update);
          PoseGraph<TypeParam> graph = solver.Graph();
          for (std::size_t k = 0; k < before.size(); ++k) graph.SetPose(graph.Poses()[k].id, before[k]);
          // Where priors begin to determine the frame, the map moves as a whole first.
          const Gauge<TypeParam>& now = solver.CurrentGauge();
          if (gauge.free_shifts != now.free_shifts || gauge.free_turns != now.free_turns) continue;
          const double chi2 = Chi2(graph);
          EXPECT_NEAR(chi2 - solver.Chi2(), report.actual_decrease, 1e-8 * (1 + chi2));
          if (guard) {
            EXPECT_LE(solver.Chi2(), chi2 * (1 + 1e-9) + 1e-9);
          } else {
            rises_without += solver.Chi2() > 1.01 * chi2 ? 1 : 0;
          }
        }
      }
    }
  }
  EXPECT_GT(rises_without, 0) << "the graphs are too easy to tell";
}

TYPED_TEST(IncrementalPointsTest, ABudgetDefersAndLaterStepsCatchUp) {
  const auto random = MakeGraph<TypeParam>(13);
  IncrementalOptions options = Points();
  options.budget_seconds = 1e-12;
  IncrementalSolver<TypeParam> solver(options);
  int deferred = 0;
  for (const auto& update : OnePosePerUpdate(random.graph)) deferred += solver.Update(update).deferred_relinearisations;
  EXPECT_GT(deferred, 0);
  const auto batch = SolveBatch(random.graph, random.truth);
  EXPECT_GT(solver.Chi2(), 1.1 * batch.chi2);
  EXPECT_NEAR(solver.Finish().chi2, batch.chi2, 1e-8 * batch.chi2);
}

TEST(IncrementalGateTest, LoopClosureCountsPosesBetweenTheEnds) {
  IncrementalOptions options = Points();
  options.gate = Gate::kLoopClosure;
  options.gate_threshold = 4;
  IncrementalSolver<SE2> solver(options);
  const auto edge = [](int a, int b) {
    return RelativePoseFactor<SE2>{{10 * a}, {10 * b}, SE2(b - a, 0, 0), SE2::Jacobian::Identity()};
  };
  solver.Update({{{{0}}}, {}, {}});
  for (int k = 1; k < 8; ++k) EXPECT_FALSE(solver.Update({{{{10 * k}}}, {edge(k - 1, k)}, {}}).gate_open);
  EXPECT_FALSE(solver.Update({{}, {edge(7, 3)}, {}}).gate_open);
  EXPECT_TRUE(solver.Update({{}, {edge(7, 2)}, {}}).gate_open);
  const PosePriorFactor<SE2> prior{{0}, SE2(), SE2::Jacobian::Identity()};
  EXPECT_FALSE(solver.Update({{}, {prior}, {}}).gate_open) << "priors never count";
  EXPECT_FALSE(solver.Update({{{{80}}}, {edge(0, 8)}, {}}).gate_open) << "to a new pose";
}

// A chain: whatever the order, L of a chain of full blocks has no fill beyond what a minimum-degree order leaves.
TEST(PaperFlopsTest, CountsAChainOfFullBlocks) {
  BlockCholesky<3> factor;
  BlockCholesky<3>::Changes changes;
  Random rng(3);
  changes.new_variables = 3;
  changes.added.push_back(Anchor<3>(0, Vector<3>::Ones()));
  for (int k = 0; k < 2; ++k) {
    LinearFactor<3> f;
    f.first = k;
    f.second = k + 1;
    for (int c = 0; c < 3; ++c) f.A_first.col(c) = testing::NormalVector<3>(rng);
    for (int c = 0; c < 3; ++c) f.A_second.col(c) = testing::NormalVector<3>(rng);
    changes.added.push_back(f);
  }
  ASSERT_TRUE(factor.Update(std::move(changes)).ok);
  const internal::PaperFlops flops(factor);
  // Nine rows without fill: entries of H's lower triangle, 3 * 6 + 2 * 9.
  EXPECT_EQ(flops.Solved(), 2 * 36);
  EXPECT_EQ(flops.Solved({0, 1, 2}), flops.Solved());
  EXPECT_EQ(flops.Updated({0, 1, 2}), flops.Updated());
  EXPECT_EQ(flops.Added(0), flops.Updated());
  EXPECT_GE(flops.Added(2), 1 + 4 + 9);
}

}  // namespace
}  // namespace terse
