// Orders of elimination (core/cholesky/ordering.h, elimination.h) on grids, whose separators are known, and random
// graphs.

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <set>
#include <thread>

#include "cholesky/elimination.h"
#include "terse/core/at.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/front_tree.h"
#include "testing_factor.h"

namespace terse::internal {
namespace {

using testing::Random;
using testing::RandomFactor;

void Add(Cliques& cliques, const std::vector<int>& members) {
  cliques.members.insert(cliques.members.end(), members.begin(), members.end());
  cliques.Close();
}

// Each of side x side variables with its eight neighbours.
Cliques Grid(int side) {
  Cliques out;
  for (int y = 0; y < side; ++y) {
    for (int x = 0; x < side; ++x) {
      const int v = y * side + x;
      if (x + 1 < side) Add(out, {v, v + 1});
      if (y + 1 < side) Add(out, {v, v + side});
      if (x + 1 < side && y + 1 < side) {
        Add(out, {v, v + side + 1});
        Add(out, {v + 1, v + side});
      }
    }
  }
  return out;
}

// A chain and random cliques: CCOLAMD puts what is in no clique at the very end.
Cliques RandomCliques(Random& rng, int variables, int count) {
  Cliques out;
  for (int v = 1; v < variables; ++v) Add(out, {v - 1, v});
  for (int c = 0; c < count; ++c) {
    std::set<int> members;
    for (std::size_t k = 0; k < 1 + rng() % 4; ++k) members.insert(static_cast<int>(rng() % At(variables)));
    Add(out, {members.begin(), members.end()});
  }
  return out;
}

void ExpectOrder(const std::vector<int>& order, const std::vector<char>& order_last) {
  std::vector<int> sorted = order, all(order_last.size());
  std::sort(sorted.begin(), sorted.end());
  std::iota(all.begin(), all.end(), 0);
  ASSERT_EQ(sorted, all);
  const auto is_last = [&](int v) { return order_last[At(v)] != 0; };
  EXPECT_TRUE(std::is_partitioned(order.rbegin(), order.rend(), is_last));
}

TEST(Ordering, EachVariableOnceMarkedOnesLast) {
  Random rng(1);
  for (int trial = 0; trial < 100; ++trial) {
    const int n = 1 + static_cast<int>(rng() % 300);
    const Cliques cliques = RandomCliques(rng, n, static_cast<int>(rng() % At(3 * n)));
    std::vector<char> order_last(At(n));
    for (char& last : order_last) last = rng() % 10 == 0 ? 1 : 0;
    SCOPED_TRACE(n);
    ExpectOrder(MinimumDegreeOrder(n, cliques, order_last), order_last);
    ExpectOrder(NestedDissectionOrder(n, cliques, order_last), order_last);
  }
  const std::vector<char> all(5, 1);
  ExpectOrder(NestedDissectionOrder(5, {}, all), all);
}

// By the definition: eliminating a variable couples all that are left of its neighbours.
TEST(Ordering, FrontsHoldWhatEliminationCouples) {
  Random rng(2);
  for (int trial = 0; trial < 30; ++trial) {
    const int side = 8 + static_cast<int>(rng() % 25), n = side * side;  // small ones are not dissected
    Cliques cliques = Grid(side);
    for (int k = 0; k < 20; ++k)
      Add(cliques, {static_cast<int>(rng() % At(n / 2)), n - 1 - static_cast<int>(rng() % At(n / 2))});
    const std::vector<SymbolicFront> fronts =
        Eliminate(n, cliques, std::vector<char>(At(n), 0), trial % 2 == 0 ? OrderFor::kUpdates : OrderFor::kSolving);
    std::vector<std::set<int>> neighbours(At(n));
    for (int c = 0; c < cliques.Count(); ++c) {
      for (int k = cliques.start[At(c)]; k < cliques.start[At(c) + 1]; ++k) {
        for (int l = cliques.start[At(c)]; l < cliques.start[At(c) + 1]; ++l) {
          neighbours[At(cliques.members[At(k)])].insert(cliques.members[At(l)]);
        }
      }
    }
    for (const SymbolicFront& front : fronts) {
      std::set<int> rows(front.separators.begin(), front.separators.end());
      rows.insert(front.pivots.begin(), front.pivots.end());
      for (const int v : front.pivots) {
        neighbours[At(v)].erase(v);
        for (const int a : neighbours[At(v)]) {
          ASSERT_EQ(rows.count(a), 1u);
          neighbours[At(a)].insert(neighbours[At(v)].begin(), neighbours[At(v)].end());
          neighbours[At(a)].erase(v);
        }
      }
    }
  }
}

// The separators of a square are its middle lines: the way from a variable to the root has O(n) entries. With minimum
// degree alone it has 4.0 n and 4.3 n here.
TEST(Ordering, NestedDissectionShortensPaths) {
  for (const int side : {40, 120}) {
    const int n = side * side;
    const Cliques cliques = Grid(side);
    const std::vector<char> none(At(n), 0);
    const FactorCost dissected = CostOf(Eliminate(n, cliques, none, OrderFor::kUpdates));
    EXPECT_LT(dissected.paths, 3.7 * n * n) << side;
    const FactorCost for_solving = CostOf(Eliminate(n, cliques, none, OrderFor::kSolving));
    EXPECT_LE(for_solving.flops, dissected.flops) << side;
  }
}

TEST(Ordering, IsTheSameWhateverHappensBeforeAndBeside) {
  const int side = 40, n = side * side;
  const Cliques cliques = Grid(side);
  const std::vector<char> none(At(n), 0);
  const std::vector<int> order = NestedDissectionOrder(n, cliques, none);
  ASSERT_FALSE(order.empty());
  NestedDissectionOrder(900, Grid(30), std::vector<char>(900, 0));
  std::vector<std::vector<int>> orders(4);
  std::vector<std::thread> threads;
  for (auto& mine : orders) threads.emplace_back([&] { mine = NestedDissectionOrder(n, cliques, none); });
  for (std::thread& thread : threads) thread.join();
  for (const auto& mine : orders) EXPECT_EQ(mine, order);
}

TEST(Ordering, HubsAndLargeCliquesAreNotDissected) {
  Cliques star;
  for (int v = 1; v < 3000; ++v) Add(star, {0, v});
  EXPECT_TRUE(NestedDissectionOrder(3000, star, std::vector<char>(3000, 0)).empty());
  Cliques large;
  std::vector<int> all(3000);
  std::iota(all.begin(), all.end(), 0);
  Add(large, all);
  EXPECT_TRUE(NestedDissectionOrder(3000, large, std::vector<char>(3000, 0)).empty());
}

// A grid whose rows come one after the other: what is ordered piece by piece stays near to what one would order at
// once. Where paths are only ever updated they grow until a look at everything finds it: to 18 times the entries of a
// fresh order, without looks to 31.
TEST(Ordering, AFactorThatGrowsStaysNearAFreshOne) {
  constexpr int B = 3;
  using Cholesky = BlockCholesky<B>;
  Random rng(3);
  const int side = 40, n = side * side;
  std::vector<std::vector<LinearFactor<B>>> factors_of(At(n));  // by later variable
  for (int v = 0; v < n; ++v) factors_of[At(v)].push_back(RandomFactor<B>(rng, v, -1));
  const Cliques grid = Grid(side);
  for (int c = 0; c < grid.Count(); ++c) {
    const int a = grid.members[At(2 * c)], b = grid.members[At(2 * c + 1)];
    factors_of[At(std::max(a, b))].push_back(RandomFactor<B>(rng, std::min(a, b), std::max(a, b)));
  }
  Cholesky::Changes all;
  all.new_variables = n;
  for (const auto& factors : factors_of) all.added.insert(all.added.end(), factors.begin(), factors.end());
  Cholesky fresh;
  ASSERT_TRUE(fresh.Update(all).ok);
  fresh.Solve();
  const Eigen::Map<const Eigen::VectorXd> expected(fresh.Solution().data(), B * n);
  const std::pair<Cholesky::Method, double> cases[] = {{Cholesky::Method::kCheapest, 1.7},
                                                       {Cholesky::Method::kRankUpdateWherePossible, 24}};
  for (const auto& [method, most] : cases) {
    Cholesky grown;
    grown.SetMethod(method);
    for (const auto& factors : factors_of) {
      Cholesky::Changes changes;
      changes.new_variables = 1;
      changes.added = factors;
      ASSERT_TRUE(grown.Update(changes).ok);
    }
    EXPECT_LT(static_cast<double>(grown.Nonzeros()), most * static_cast<double>(fresh.Nonzeros()));
    EXPECT_NEAR(grown.LogDeterminant(), fresh.LogDeterminant(), 1e-9 * fresh.LogDeterminant());
    grown.Solve();
    const Eigen::Map<const Eigen::VectorXd> solution(grown.Solution().data(), B * n);
    EXPECT_LT((solution - expected).norm(), 1e-9 * expected.norm());
  }
}

// A loop now and then, so that paths grow.
int FreshOrders(double limit) {
  constexpr int B = 3;
  Random rng(6);
  BlockCholesky<B> cholesky;
  cholesky.LimitReordering(limit);
  int fresh = 0;
  for (int v = 0; v < 900; ++v) {
    BlockCholesky<B>::Changes changes;
    changes.new_variables = 1;
    changes.added.push_back(RandomFactor<B>(rng, v, -1));
    if (v > 0) changes.added.push_back(RandomFactor<B>(rng, v - 1, v));
    if (v > 30 && v % 3 == 0) {
      changes.added.push_back(RandomFactor<B>(rng, static_cast<int>(rng() % static_cast<std::uint64_t>(v - 5)), v));
    }
    const auto report = cholesky.Update(std::move(changes));
    EXPECT_TRUE(report.ok);
    fresh += v > 150 && report.path == CholeskyPath::kRefactored && report.variables == v + 1;
  }
  return fresh;
}

TEST(Ordering, FreshOrdersThatTakeTooLongForAStepAreRare) {
  const int unlimited = FreshOrders(0), limited = FreshOrders(1e6);
  EXPECT_EQ(FreshOrders(1e12), unlimited);
  EXPECT_GT(unlimited, 0);
  EXPECT_LT(limited, unlimited);
}

// A random order of a grid fills the factor.
TEST(Ordering, AFactorIsEliminatedInTheOrderThatItIsGiven) {
  constexpr int B = 3;
  Random rng(8);
  const int side = 20, n = side * side;
  BlockCholesky<B>::Changes all;
  all.new_variables = n;
  for (int v = 0; v < n; ++v) all.added.push_back(RandomFactor<B>(rng, v, -1));
  const Cliques grid = Grid(side);
  for (int c = 0; c < grid.Count(); ++c)
    all.added.push_back(RandomFactor<B>(rng, grid.members[At(2 * c)], grid.members[At(2 * c + 1)]));
  std::vector<int> shuffled(At(n));
  std::iota(shuffled.begin(), shuffled.end(), 0);
  std::shuffle(shuffled.begin(), shuffled.end(), rng);
  const auto factored = [&](const std::vector<int>& order) {
    BlockCholesky<B> cholesky;
    cholesky.SetOrder(order);
    EXPECT_TRUE(cholesky.Update(all).ok);
    cholesky.Solve();
    return cholesky;
  };
  const BlockCholesky<B> free = factored({}), filled = factored(shuffled), short_order = factored({1, 0});
  EXPECT_GT(filled.Nonzeros(), 1.5 * static_cast<double>(free.Nonzeros()));
  EXPECT_EQ(short_order.Nonzeros(), free.Nonzeros());
  const Eigen::Map<const Eigen::VectorXd> x(free.Solution().data(), B * n), y(filled.Solution().data(), B * n);
  EXPECT_LT((x - y).norm(), 1e-10 * y.norm());
  BlockCholesky<B> cholesky;
  shuffled.back() = shuffled.front();
  EXPECT_THROW(cholesky.SetOrder(shuffled), std::invalid_argument);
  EXPECT_THROW(cholesky.SetOrder({0, -1}), std::invalid_argument);
}

double ScalarsOfUpdates(const FrontTree<3>& tree) {
  double sum = 0;
  for (const int f : tree.TopDown()) sum += static_cast<double>(tree[f].update.size());
  return sum;
}

// A factor without its update matrices is the same to the last bit, and a later update makes it anew.
TEST(Ordering, UpdateMatricesAreDropped) {
  constexpr int B = 3;
  using Cholesky = BlockCholesky<B>;
  Random rng(4);
  const int side = 120, n = side * side;
  Cholesky::Changes all;
  all.new_variables = n;
  for (int v = 0; v < n; ++v) all.added.push_back(RandomFactor<B>(rng, v, -1));
  const Cliques grid = Grid(side);
  for (int c = 0; c < grid.Count(); ++c)
    all.added.push_back(RandomFactor<B>(rng, grid.members[At(2 * c)], grid.members[At(2 * c + 1)]));
  Cholesky::Changes late;
  late.added.push_back(RandomFactor<B>(rng, 3, n - 5));
  std::vector<std::vector<double>> expected;  // of the first, refactored, updated
  for (const auto& [drops, threads] : {std::pair(false, 1), std::pair(true, 1), std::pair(true, 3)}) {
    SCOPED_TRACE(std::to_string(drops) + ' ' + std::to_string(threads));
    Cholesky cholesky;
    cholesky.SetThreads(threads);
    if (drops) cholesky.DropUpdateMatrices();
    std::vector<std::vector<double>> found;
    ASSERT_TRUE(cholesky.Update(all).ok);
    cholesky.Solve();
    found.push_back(cholesky.Solution());
    const double scalars = ScalarsOfUpdates(cholesky.Tree());
    EXPECT_EQ(scalars < 1e6, drops) << scalars;
    ASSERT_TRUE(cholesky.Refactor(std::vector<double>(At(B * n), 0.1)));
    cholesky.Solve();
    found.push_back(cholesky.Solution());
    ASSERT_TRUE(cholesky.Refactor());
    if (drops) {
      EXPECT_THROW(cholesky.Prepare({{0, all.added[0]}}), std::logic_error);
    }
    ASSERT_TRUE(cholesky.Update(late).ok);
    cholesky.Solve();
    found.push_back(cholesky.Solution());
    if (expected.empty()) expected = found;
    EXPECT_EQ(found[0], expected[0]);
    EXPECT_EQ(found[1], expected[1]);
    const Eigen::Map<const Eigen::VectorXd> x(found[2].data(), B * n), y(expected[2].data(), B * n);
    EXPECT_LT((x - y).norm(), 1e-9 * y.norm());
  }
}

}  // namespace
}  // namespace terse::internal
