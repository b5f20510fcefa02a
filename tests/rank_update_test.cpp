// The ways to bring the factor up to date without factoring it again, against dense linear algebra after every change.

#include <gtest/gtest.h>

#include <array>
#include <limits>

#include "testing_factor.h"

namespace terse {
namespace {

using testing::ExpectEqualsDense;
using testing::ExpectSoundTree;
using testing::MirroredFactor;
using testing::Random;

template <int B>
using Method = typename BlockCholesky<B>::Method;

// Well-conditioned blocks: what hangs on a single one of them keeps its digits.
template <int B>
LinearFactor<B> MildFactor(Random& rng, int first, int second) {
  LinearFactor<B> f = testing::RandomFactor<B>(rng, first, second);
  f.A_first.diagonal().array() += 4;
  if (second >= 0) f.A_second.diagonal().array() -= 4;
  return f;
}

int Below(Random& rng, int n) { return static_cast<int>(rng() % static_cast<std::uint64_t>(n)); }

template <class Size>
class RankUpdate : public ::testing::Test {
 public:
  static constexpr int B = Size::value;
  using Factor = BlockCholesky<B>;
  using Changes = typename Factor::Changes;
};
using Sizes = ::testing::Types<std::integral_constant<int, 3>, std::integral_constant<int, 6>>;
TYPED_TEST_SUITE(RankUpdate, Sizes);

// A chain of variables, each held by a unary factor.
template <int B>
typename BlockCholesky<B>::Changes Chain(Random& rng, int n) {
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = n;
  for (int v = 0; v < n; ++v) {
    changes.added.push_back(MildFactor<B>(rng, v, -1));
    if (v > 0) changes.added.push_back(MildFactor<B>(rng, v - 1, v));
  }
  return changes;
}

// One link between variables that are there, if they differ.
template <int B>
void AddLink(Random& rng, int n, typename BlockCholesky<B>::Changes& changes) {
  const int i = Below(rng, n), j = Below(rng, n);
  if (i != j) changes.added.push_back(MildFactor<B>(rng, i, j));
}

// Additions only: leaves, chains of them, links between any, unary factors.
template <int B>
typename BlockCholesky<B>::Changes RandomAdditions(Random& rng, int n) {
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = Below(rng, 3);
  for (int v = n; v < n + changes.new_variables; ++v) {
    const int to = rng() % 2 == 0 ? v - 1 : Below(rng, v);
    changes.added.push_back(rng() % 2 == 0 ? MildFactor<B>(rng, v, to) : MildFactor<B>(rng, to, v));
  }
  if (rng() % 2 == 0) AddLink<B>(rng, n + changes.new_variables, changes);
  if (rng() % 4 == 0) changes.added.push_back(MildFactor<B>(rng, Below(rng, n), -1));
  return changes;
}

TYPED_TEST(RankUpdate, AdditionsEqualDenseByEveryMethod) {
  constexpr int B = TestFixture::B;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    std::map<CholeskyPath, int> paths[3];
    for (int m = 0; m < 3; ++m) {
      const auto method = std::array{Method<B>::kRankUpdateWherePossible, Method<B>::kCheapest,
                                     Method<B>::kRefactor}[static_cast<std::size_t>(m)];
      SCOPED_TRACE("seed " + std::to_string(seed) + ", method " + std::to_string(m));
      Random rng(seed);
      MirroredFactor<B> both;
      both.factor.SetMethod(method);
      both.Apply(Chain<B>(rng, 3));
      for (int step = 0; step < 35; ++step) {
        const auto report = both.Apply(RandomAdditions<B>(rng, both.mirror.variables));
        ASSERT_TRUE(report.ok);
        ++paths[m][report.path];
        // Now and then several updates come in before the next solve.
        if (rng() % 3 != 0) ExpectEqualsDense(both.factor, both.mirror);
        ExpectSoundTree(both.factor);
        if (this->HasFatalFailure()) return;
      }
      ExpectEqualsDense(both.factor, both.mirror);
    }
    EXPECT_GT(paths[0][CholeskyPath::kRankUpdate], 5);
    EXPECT_GT(paths[0][CholeskyPath::kAppended], 2);
    EXPECT_GT(paths[1][CholeskyPath::kRankUpdate], 0);
    EXPECT_EQ(paths[2][CholeskyPath::kRankUpdate] + paths[2][CholeskyPath::kAppended], 0);
  }
}

TYPED_TEST(RankUpdate, LeavesAreAppendedAndChangeNothingAbove) {
  constexpr int B = TestFixture::B;
  Random rng(2);
  MirroredFactor<B> both;
  both.Apply(Chain<B>(rng, 5));
  ExpectEqualsDense(both.factor, both.mirror);
  const double decrement = both.factor.NewtonDecrement();
  // Several at once, a chain among them, in either direction.
  typename TestFixture::Changes leaves;
  leaves.new_variables = 5;
  leaves.added = {MildFactor<B>(rng, 1, 5), MildFactor<B>(rng, 6, 3), MildFactor<B>(rng, 6, 7),
                  MildFactor<B>(rng, 8, 7), MildFactor<B>(rng, 1, 9)};
  const auto report = both.Apply(leaves);
  EXPECT_EQ(report.path, CholeskyPath::kAppended);
  EXPECT_EQ(report.fronts, 5);
  // Factors that can be met exactly predict no change.
  EXPECT_NEAR(both.factor.NewtonDecrement() - decrement,
              leaves.added[0].residual.squaredNorm() + leaves.added[1].residual.squaredNorm() +
                  leaves.added[2].residual.squaredNorm() + leaves.added[3].residual.squaredNorm() +
                  leaves.added[4].residual.squaredNorm(),
              1e-9 * both.factor.NewtonDecrement());
  ExpectEqualsDense(both.factor, both.mirror);
  ExpectSoundTree(both.factor);
  // A chain of leaves in single steps, none of them solved for; then a loop on top of them.
  for (int k = 0; k < 6; ++k) {
    const int n = both.mirror.variables;
    typename TestFixture::Changes leaf;
    leaf.new_variables = 1;
    leaf.added = {MildFactor<B>(rng, n - 1, n)};
    EXPECT_EQ(both.Apply(leaf).path, CholeskyPath::kAppended);
  }
  for (const auto method : {Method<B>::kRankUpdateWherePossible, Method<B>::kRefactor}) {
    auto copy = both;
    copy.factor.SetMethod(method);
    typename TestFixture::Changes loop;
    loop.added = {MildFactor<B>(rng, 0, copy.mirror.variables - 1)};
    ASSERT_TRUE(copy.Apply(loop).ok);
    ExpectEqualsDense(copy.factor, copy.mirror);
    ExpectSoundTree(copy.factor);
  }
}

// What measures a new variable badly or twice is no leaf.
TYPED_TEST(RankUpdate, OnlySingleWellConditionedFactorsAppend) {
  constexpr int B = TestFixture::B;
  Random rng(3);
  for (int kind = 0; kind < 3; ++kind) {
    MirroredFactor<B> both;
    both.Apply(Chain<B>(rng, 4));
    typename TestFixture::Changes changes;
    changes.new_variables = 1;
    changes.added = {MildFactor<B>(rng, 2, 4)};
    if (kind == 0) changes.added.push_back(MildFactor<B>(rng, 0, 4));
    if (kind == 1) changes.added.push_back(MildFactor<B>(rng, 4, -1));
    if (kind == 2) changes.added[0].A_second.col(0) *= 1e-7;  // a direction that is hardly measured
    const auto report = both.Apply(changes);
    ASSERT_TRUE(report.ok);
    EXPECT_NE(report.path, CholeskyPath::kAppended) << kind;
    if (kind < 2) ExpectEqualsDense(both.factor, both.mirror);
  }
}

// Rank updates put off what they change in the update matrices. What comes later has to find it there.
TYPED_TEST(RankUpdate, WaitingCorrectionsReachWhateverComesNext) {
  constexpr int B = TestFixture::B;
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random rng(seed);
    MirroredFactor<B> both;
    both.factor.SetMethod(Method<B>::kRankUpdateWherePossible);
    both.Apply(Chain<B>(rng, 14));
    for (int round = 0; round < 6; ++round) {
      int updates = 0;
      // Enough for corrections to be worked in on the way (48 columns).
      for (int k = 0; k < 96 / B; ++k) {
        typename TestFixture::Changes changes;
        AddLink<B>(rng, 14, changes);
        if (changes.added.empty()) continue;
        const auto report = both.Apply(changes);
        ASSERT_TRUE(report.ok);
        updates += report.path == CholeskyPath::kRankUpdate ? 1 : 0;
      }
      EXPECT_GT(round > 0 ? 100 : updates, 10);
      ExpectEqualsDense(both.factor, both.mirror);
      if (this->HasFatalFailure()) return;
      // Then one factor is replaced or removed, which refactors part of the tree.
      typename TestFixture::Changes changes;
      for (const auto& [slot, f] : both.mirror.by_slot) {
        if (f.second < 0) continue;
        if (round % 2 == 0 && changes.replaced.empty() && rng() % 8 == 0) {
          changes.replaced.emplace_back(slot, MildFactor<B>(rng, f.first, f.second));
        } else if (round % 2 == 1 && changes.removed.empty() && rng() % 8 == 0) {
          changes.removed.push_back(slot);
        }
      }
      ASSERT_TRUE(both.Apply(changes).ok);
      ExpectEqualsDense(both.factor, both.mirror);
      ExpectSoundTree(both.factor);
      if (round == 3) {
        ASSERT_TRUE(both.factor.Refactor());
        ExpectEqualsDense(both.factor, both.mirror);
      }
      if (this->HasFatalFailure()) return;
    }
  }
}

TYPED_TEST(RankUpdate, FailureChangesNothingByAnyMethod) {
  constexpr int B = TestFixture::B;
  for (const auto method : {Method<B>::kCheapest, Method<B>::kRankUpdateWherePossible, Method<B>::kRefactor}) {
    SCOPED_TRACE("method " + std::to_string(static_cast<int>(method)));
    Random rng(4);
    MirroredFactor<B> both;
    both.factor.SetMethod(method);
    both.Apply(Chain<B>(rng, 8));
    for (int k = 0; k < 5; ++k) both.Apply(RandomAdditions<B>(rng, both.mirror.variables));
    const int n = both.mirror.variables;
    std::vector<typename TestFixture::Changes> bad(6);
    const double nan = std::numeric_limits<double>::quiet_NaN();
    for (auto& changes : bad) changes.added.push_back(MildFactor<B>(rng, 0, 5));
    // Nothing measures it, or not all of it, or not with a finite residual.
    bad[0].new_variables = 1;
    bad[1].new_variables = 2;
    bad[1].added.push_back(MildFactor<B>(rng, n, n + 1));
    bad[2].new_variables = 1;
    bad[2].added.push_back(MildFactor<B>(rng, 2, n));
    bad[2].added.back().A_second.col(0).setZero();
    bad[3].added.push_back(MildFactor<B>(rng, 1, 6));
    bad[3].added.back().residual[1] = nan;
    bad[4].new_variables = 1;
    bad[4].added = {MildFactor<B>(rng, 2, n)};
    bad[4].added.back().residual[0] = std::numeric_limits<double>::infinity();
    bad[5].added.back().A_first(0, 0) = nan;
    BlockCholesky<B> untouched = both.factor;
    const double log_det = both.factor.LogDeterminant(), decrement = both.factor.NewtonDecrement();
    for (std::size_t k = 0; k < bad.size(); ++k) {
      SCOPED_TRACE("bad changes " + std::to_string(k));
      const auto report = both.factor.Update(bad[k]);
      EXPECT_FALSE(report.ok);
      EXPECT_GE(report.failed_variable, 0);
      EXPECT_TRUE(report.added_slots.empty());
      EXPECT_EQ(both.factor.Variables(), n);
      EXPECT_EQ(both.factor.LogDeterminant(), log_det);
      EXPECT_EQ(both.factor.NewtonDecrement(), decrement);
      ExpectEqualsDense(both.factor, both.mirror);
      ExpectSoundTree(both.factor);
      if (this->HasFatalFailure()) return;
    }
    // Nor what comes after them, to the last bit: which way an update takes depends on what others have cost.
    for (int k = 0; k < 30; ++k) {
      const auto changes = RandomAdditions<B>(rng, both.mirror.variables);
      ASSERT_TRUE(both.Apply(changes).ok);
      ASSERT_TRUE(untouched.Update(changes).ok);
      ASSERT_EQ(both.factor.LogDeterminant(), untouched.LogDeterminant()) << k;
      ASSERT_EQ(both.factor.NewtonDecrement(), untouched.NewtonDecrement()) << k;
      if (k < 5) ExpectEqualsDense(both.factor, both.mirror);
    }
  }
}

TYPED_TEST(RankUpdate, DeferredSubtreesReachTheExactSolution) {
  constexpr int B = TestFixture::B;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    Random rng(seed);
    MirroredFactor<B> both;
    both.Apply(Chain<B>(rng, 40));
    const auto past = BlockCholesky<B>::Clock::now() - std::chrono::seconds(1);
    int deferred = 0;
    for (int step = 0; step < 30; ++step) {
      auto changes = RandomAdditions<B>(rng, both.mirror.variables);
      if (rng() % 4 == 0) {  // fronts that wait go, and others take their numbers
        const auto& [slot, f] = *std::next(both.mirror.by_slot.begin(), Below(rng, 20));
        changes.replaced.emplace_back(slot, MildFactor<B>(rng, f.first, f.second));
      }
      ASSERT_TRUE(both.Apply(changes).ok);
      both.factor.Solve(0, past);
      deferred += both.factor.LastSolve().deferred;
    }
    EXPECT_GT(deferred, 0);
    auto copy = both;
    ExpectEqualsDense(copy.factor, copy.mirror);  // at once
    // Or a front at a time: every solve gets on.
    int solves = 0;
    do {
      both.factor.Solve(0, past);
      ASSERT_LT(++solves, 2000);
    } while (both.factor.LastSolve().deferred > 0);
    EXPECT_GT(solves, 3);
    EXPECT_EQ(both.factor.Solution().size(), copy.factor.Solution().size());
    const auto n = static_cast<Eigen::Index>(copy.factor.Solution().size());
    EXPECT_LT(testing::RelativeError(Eigen::Map<const Eigen::VectorXd>(both.factor.Solution().data(), n),
                                     Eigen::Map<const Eigen::VectorXd>(copy.factor.Solution().data(), n)),
              1e-12);
  }
}

// What stays behind is below the threshold, seen from what stays behind above it; and an exact solve that touches
// everything afterwards is exact.
TYPED_TEST(RankUpdate, ThresholdLeavesLittleBehind) {
  constexpr int B = TestFixture::B;
  Random rng(5);
  MirroredFactor<B> both;
  both.Apply(Chain<B>(rng, 30));
  both.factor.Solve();
  double worst = 0, exact_flops = 0, flops = 0;
  for (int step = 0; step < 30; ++step) {
    both.Apply(RandomAdditions<B>(rng, both.mirror.variables));
    auto exact = both.factor;
    exact.Solve();
    exact_flops += exact.LastSolve().flops;
    const double threshold = 1e-4;
    both.factor.Solve(threshold);
    flops += both.factor.LastSolve().flops;
    const auto dense = both.mirror.Dense();
    const auto n = static_cast<Eigen::Index>(both.factor.Solution().size());
    const Eigen::VectorXd d = Eigen::Map<const Eigen::VectorXd>(both.factor.Solution().data(), n);
    const Eigen::VectorXd error = d - testing::Solve(dense.H, dense.b);
    worst = std::max(worst, error.dot(dense.H * error));  // what chi2 is above its minimum
  }
  EXPECT_GT(worst, 0);
  EXPECT_LT(worst, 0.1);
  EXPECT_LT(flops, exact_flops);
  ASSERT_TRUE(both.factor.Refactor());
  ExpectEqualsDense(both.factor, both.mirror);
}

// Rank-k updates keep every new variable in the root; when the graph has doubled all of it is ordered again.
TYPED_TEST(RankUpdate, OrdersEverythingAgainWhenTheFillHasDrifted) {
  constexpr int B = TestFixture::B;
  Random rng(23);
  MirroredFactor<B> mirrored;
  mirrored.factor.SetMethod(Method<B>::kRankUpdateWherePossible);
  mirrored.Apply(Chain<B>(rng, 3));
  int ordered = 0;
  for (int v = 3; v < 130; ++v) {
    typename BlockCholesky<B>::Changes changes;
    changes.new_variables = 1;
    changes.added = {MildFactor<B>(rng, v - 1, v), MildFactor<B>(rng, v - 2, v)};
    const auto report = mirrored.Apply(changes);
    if (report.path == CholeskyPath::kRefactored && report.variables == v + 1) ++ordered;
  }
  EXPECT_EQ(ordered, 1);
  ExpectEqualsDense(mirrored.factor, mirrored.mirror);
  ExpectSoundTree(mirrored.factor);
}

}  // namespace
}  // namespace terse
