// Poses with very many factors: the cost of a step may not grow with them, and the sums of a hub are exact. Each run is
// of a size at which cost quadratic in the degree takes longer than ctest waits (10 minutes); none takes seconds.

#include <gtest/gtest.h>

#include <cmath>

#include "slow_build.h"
#include "terse/core/batch_solver.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/initial_values.h"
#include "testing_factor.h"

namespace terse {
namespace {

using testing::Random;
using testing::RandomFactor;

constexpr int kDegree = kSlowBuild ? 30000 : 200000;

RelativePoseFactor<SE2> Edge(int from, int to, double x, double y) {
  return {{from}, {to}, SE2({x, y}, 0.0), SE2::Jacobian::Identity()};
}

// Counted anew from all factors, in the order of their slots.
template <int B>
std::vector<double> DiagonalFromScratch(BlockCholesky<B> factor) {
  std::vector<LinearFactor<B>> all;
  for (int slot = 0; slot < factor.Slots(); ++slot) all.push_back(factor.LinearFactorAt(slot));
  factor.SetLinearFactors(all);
  return factor.System().Diagonal();
}

template <int B>
std::vector<double> PlainSum(const BlockCholesky<B>& factor) {
  std::vector<double> sum(static_cast<std::size_t>(factor.Variables() * B), 0.0);
  for (int slot = 0; slot < factor.Slots(); ++slot) {
    const LinearFactor<B>& f = factor.LinearFactorAt(slot);
    for (int c = 0; c < B; ++c) {
      if (f.first >= 0) sum[static_cast<std::size_t>(f.first * B + c)] += f.A_first.col(c).squaredNorm();
      if (f.first >= 0 && f.second >= 0) {
        sum[static_cast<std::size_t>(f.second * B + c)] += f.A_second.col(c).squaredNorm();
      }
    }
  }
  return sum;
}

// A hub's diagonal does not depend on how its factors came and went: neither while it grows past the degree from which
// it is kept in blocks, nor on the way back, nor after an update that failed.
TEST(Degree, DiagonalOfAHubHasNoHistory) {
  constexpr int B = 3;
  Random rng(7);
  BlockCholesky<B> factor;
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = 5;
  for (int v = 0; v < 5; ++v) changes.added.push_back(RandomFactor<B>(rng, v, -1));
  ASSERT_TRUE(factor.Update(changes).ok);
  std::vector<int> slots;
  const auto check = [&] {
    const std::vector<double> now = factor.System().Diagonal(), plain = PlainSum(factor);
    EXPECT_EQ(now, DiagonalFromScratch(factor));
    for (std::size_t k = 0; k < now.size(); ++k) EXPECT_NEAR(now[k], plain[k], 1e-12 * plain[k]);
  };
  for (int step = 0; step < 60; ++step) {
    changes = {};
    const bool grows = step < 30;
    for (int k = 0; k < 100; ++k) {
      changes.added.push_back(RandomFactor<B>(rng, 0, 1 + static_cast<int>(rng() % 4)));
      if (!grows) changes.added.pop_back();
    }
    std::set<std::size_t> taken;
    for (int k = 0; k < (grows ? 20 : 90) && !slots.empty(); ++k) {
      const std::size_t at = rng() % slots.size();
      if (!taken.insert(at).second) continue;
      const LinearFactor<B>& old = factor.LinearFactorAt(slots[at]);
      if (!grows || k % 2 == 0) {
        changes.removed.push_back(slots[at]);
      } else {
        changes.replaced.emplace_back(slots[at], RandomFactor<B>(rng, old.first, old.second));
      }
    }
    // The same with a factor that is not finite: refused, and nothing is different.
    auto bad = changes;
    bad.added.push_back(RandomFactor<B>(rng, 0, 2));
    bad.added.back().residual[0] = std::nan("");
    const std::vector<double> before = factor.System().Diagonal();
    ASSERT_FALSE(factor.Update(bad).ok);
    EXPECT_EQ(factor.System().Diagonal(), before);
    check();
    const auto report = factor.Update(changes);
    ASSERT_TRUE(report.ok);
    for (const int slot : changes.removed) slots.erase(std::find(slots.begin(), slots.end(), slot));
    slots.insert(slots.end(), report.added_slots.begin(), report.added_slots.end());
    check();
  }
  EXPECT_LT(factor.SlotsOf(0).size(), 1024u);
}

// Refactoring a part of the tree gives the same whether its factors come from the variables or, beside a hub, from the
// fronts: against everything factored at once.
TEST(Degree, PartsBesideAHubEqualTheWhole) {
  constexpr int B = 3, kLeaves = 1500;
  Random rng(8);
  BlockCholesky<B> factor;
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = kLeaves + 1;
  changes.added.push_back(RandomFactor<B>(rng, 0, -1));
  for (int v = 1; v <= kLeaves; ++v) {
    changes.added.push_back(RandomFactor<B>(rng, 0, v));
    changes.added.push_back(RandomFactor<B>(rng, v, -1));
    if (v > 1) changes.added.push_back(RandomFactor<B>(rng, v - 1, v));
  }
  ASSERT_TRUE(factor.Update(changes).ok);
  for (int step = 0; step < 20; ++step) {
    changes = {};
    const int v = 1 + static_cast<int>(rng() % kLeaves);
    for (const int slot : factor.SlotsOf(v)) {
      const LinearFactor<B>& old = factor.LinearFactorAt(slot);
      changes.replaced.emplace_back(slot, RandomFactor<B>(rng, old.first, old.second));
    }
    changes.added.push_back(RandomFactor<B>(rng, 0, v));
    ASSERT_TRUE(factor.Update(changes).ok);
    factor.Solve();
    typename BlockCholesky<B>::Changes all;
    all.new_variables = factor.Variables();
    for (int slot = 0; slot < factor.Slots(); ++slot) all.added.push_back(factor.LinearFactorAt(slot));
    BlockCholesky<B> whole;
    ASSERT_TRUE(whole.Update(all).ok);
    whole.Solve();
    EXPECT_NEAR(factor.LogDeterminant(), whole.LogDeterminant(), 1e-9 * std::abs(whole.LogDeterminant()));
    EXPECT_NEAR(factor.NewtonDecrement(), whole.NewtonDecrement(), 1e-9 * whole.NewtonDecrement());
    for (std::size_t k = 0; k < factor.Solution().size(); ++k) {
      ASSERT_NEAR(factor.Solution()[k], whole.Solution()[k], 1e-8);
    }
  }
}

TEST(Degree, ParallelEdgesAtOnce) {
  PoseGraph<SE2> graph;
  graph.AddPose({0}, SE2());
  graph.AddPose({1}, SE2({1, 0}, 0.0));
  for (int k = 0; k < kDegree; ++k) graph.AddFactor(Edge(0, 1, 1 + (k % 2 == 0 ? 0.1 : -0.1), 0));
  const auto result = SolveBatch(graph);
  EXPECT_TRUE(result.Converged());
  EXPECT_NEAR(result.T_world_body[1].Translation()[0], 1, 1e-9);
  EXPECT_NEAR(result.chi2, kDegree * 0.01, 1e-6 * kDegree);
}

TEST(Degree, ParallelEdgesOneByOneAndOutAgain) {
  IncrementalSolver<SE2> solver;
  GraphUpdate<SE2> first;
  first.poses = {{{0}, SE2()}, {{1}}};
  first.factors = {Edge(0, 1, 1, 0)};
  solver.Update(first);
  std::vector<FactorId> ids;
  for (int k = 0; k < kDegree; ++k) {
    GraphUpdate<SE2> update;
    update.factors = {Edge(0, 1, 1 + (k % 2 == 0 ? 0.1 : -0.1), 0)};
    ids.push_back(solver.Update(update).factor_ids[0]);
  }
  EXPECT_NEAR(solver.Estimate({1}).Translation()[0], 1, 1e-3);
  GraphUpdate<SE2> out;
  out.removed.assign(ids.begin(), ids.end());
  solver.Update(out);
  EXPECT_EQ(solver.Graph().Factors().size(), 1u);
  EXPECT_NEAR(solver.Chi2(), 0, 1e-9);
}

// The hub of a star and of a wheel: its leaves are eliminated one after the other, each beside it.
TEST(Degree, StarsAndWheelsAreOrderedInLinearTime) {
  for (const bool is_wheel : {false, true}) {
    PoseGraph<SE2> graph;
    graph.AddPose({0}, SE2());
    const double step = 2 * 3.14159265358979 / kDegree, rim = 10 * step;
    for (int k = 1; k <= kDegree; ++k) {
      const Eigen::Vector2d p(10 * std::cos(k * step), 10 * std::sin(k * step));
      graph.AddPose({k}, SE2(p, 0.0));
      graph.AddFactor(Edge(0, k, p[0], p[1]));
      if (is_wheel && k > 1)
        graph.AddFactor(Edge(k - 1, k, -rim * std::sin((k - 0.5) * step), rim * std::cos((k - 0.5) * step)));
    }
    BatchOptions options;
    options.max_iterations = 3;
    const auto result = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kFile), options);
    EXPECT_NE(result.termination, Termination::kNotPositiveDefinite);
    EXPECT_LT(result.chi2, 1e-6);
  }
}

TEST(Degree, LeavesComeOneByOne) {
  IncrementalSolver<SE2> solver;
  GraphUpdate<SE2> first;
  first.poses = {{{0}, SE2()}};
  solver.Update(first);
  for (int k = 1; k <= kDegree; ++k) {
    GraphUpdate<SE2> update;
    update.poses = {{{k}}};
    update.factors = {Edge(0, k, std::cos(k), std::sin(k))};
    solver.Update(update);
  }
  EXPECT_NEAR(solver.Estimate({kDegree}).Translation()[0], std::cos(kDegree), 1e-9);
}

}  // namespace
}  // namespace terse
