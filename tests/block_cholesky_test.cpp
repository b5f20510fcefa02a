// The multifrontal factor against dense linear algebra, after every change of a random graph.

#include "terse/core/block_cholesky.h"
#include "terse/core/buffer_pool.h"

#include <gtest/gtest.h>

#include "terse/core/front_paths.h"
#include "testing_factor.h"

namespace terse {
namespace {

using testing::Random;
using testing::Uniform;

using testing::ExpectEqualsDense;
using testing::ExpectSoundTree;
using testing::kTolerance;
using testing::Mirror;
using testing::RandomFactor;

template <int B>
void RunRandomChanges(std::uint64_t seed) {
  SCOPED_TRACE("seed " + std::to_string(seed) + ", block size " + std::to_string(B));
  Random rng(seed);
  BlockCholesky<B> factor;
  Mirror<B> mirror;
  const auto apply = [&](typename BlockCholesky<B>::Changes changes) {
    const auto copy = changes;
    const auto report = factor.Update(std::move(changes));
    ASSERT_TRUE(report.ok);
    mirror.variables += copy.new_variables;
    for (const int slot : copy.removed) mirror.by_slot.erase(slot);
    for (const auto& [slot, f] : copy.replaced) mirror.by_slot[slot] = f;
    for (std::size_t k = 0; k < copy.added.size(); ++k) mirror.by_slot[report.added_slots[k]] = copy.added[k];
  };
  for (int step = 0; step < 40; ++step) {
    typename BlockCholesky<B>::Changes changes;
    const int n = mirror.variables;
    if (step == 0) {
      changes.new_variables = 1;
      changes.added.push_back(RandomFactor<B>(rng, 0, -1));
    } else {
      // Some steps replace, and nothing else.
      const bool only_replaces = n > 3 && rng() % 4 == 0;
      if (!only_replaces) changes.new_variables = static_cast<int>(rng() % 3);
      for (int v = n; v < n + changes.new_variables; ++v) {
        changes.added.push_back(RandomFactor<B>(rng, v, -1));
        changes.added.push_back(RandomFactor<B>(rng, v - 1, v));
      }
      if (!only_replaces && n > 3 && rng() % 2 == 0) {
        const int i = static_cast<int>(rng() % static_cast<std::uint64_t>(n));
        const int j = static_cast<int>(rng() % static_cast<std::uint64_t>(n));
        if (i != j) changes.added.push_back(RandomFactor<B>(rng, i, j));
      }
      for (const auto& [slot, f] : mirror.by_slot) {
        if (rng() % 10 == 0) changes.replaced.emplace_back(slot, RandomFactor<B>(rng, f.first, f.second));
        // Unary factors stay: without one the matrix could become singular.
        else if (!only_replaces && f.second >= 0 && rng() % 25 == 0)
          changes.removed.push_back(slot);
      }
    }
    apply(std::move(changes));
    ExpectEqualsDense(factor, mirror);
    ExpectSoundTree(factor);
    if (::testing::Test::HasFatalFailure()) return;
  }
}

TEST(BlockCholesky, EqualsDenseAfterEveryChange) {
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    RunRandomChanges<3>(seed);
    RunRandomChanges<6>(seed);
    if (HasFatalFailure()) return;
  }
}

TEST(BlockCholesky, BatchAndRefactorEqualDense) {
  Random rng(5);
  for (const int n : {1, 2, 7, 40, 120}) {
    BlockCholesky<3> factor;
    Mirror<3> mirror;
    BlockCholesky<3>::Changes changes;
    changes.new_variables = mirror.variables = n;
    for (int v = 0; v < n; ++v) {
      changes.added.push_back(RandomFactor<3>(rng, v, -1));
      for (int k = 0; k < 3 && v > 0; ++k) {
        changes.added.push_back(RandomFactor<3>(rng, static_cast<int>(rng() % static_cast<std::uint64_t>(v)), v));
      }
    }
    for (std::size_t k = 0; k < changes.added.size(); ++k) mirror.by_slot[static_cast<int>(k)] = changes.added[k];
    ASSERT_TRUE(factor.Update(changes).ok);
    ExpectEqualsDense(factor, mirror);
    std::vector<LinearFactor<3>> values;
    for (auto& [slot, f] : mirror.by_slot) {
      f = RandomFactor<3>(rng, f.first, f.second);
      values.push_back(f);
    }
    factor.SetLinearFactors(values);
    ASSERT_TRUE(factor.Refactor());
    ExpectEqualsDense(factor, mirror);

    // Exchanged instead of copied, the old ones come back.
    std::vector<LinearFactor<3>> exchanged = values;
    for (std::size_t k = 0; k < exchanged.size(); ++k) {
      mirror.by_slot[static_cast<int>(k)] = exchanged[k] = RandomFactor<3>(rng, values[k].first, values[k].second);
    }
    factor.ExchangeLinearFactors(exchanged);
    EXPECT_EQ(exchanged.back().A_first, values.back().A_first);
    ASSERT_TRUE(factor.Refactor());
    ExpectEqualsDense(factor, mirror);
    exchanged.pop_back();
    EXPECT_THROW(factor.ExchangeLinearFactors(exchanged), std::invalid_argument);
    ExpectEqualsDense(factor, mirror);

    // Damping adds to the diagonal and goes again.
    std::vector<double> damping(static_cast<std::size_t>(3 * n));
    for (double& x : damping) x = Uniform(rng, 0.1, 2);
    ASSERT_TRUE(factor.Refactor(damping));
    factor.Solve();
    auto dense = mirror.Dense();
    dense.H.diagonal() += Eigen::Map<Eigen::VectorXd>(damping.data(), 3 * n);
    const Eigen::VectorXd x = testing::Solve(dense.H, dense.b);
    const Eigen::Map<const Eigen::VectorXd> d(factor.Solution().data(), 3 * n);
    EXPECT_LT(testing::RelativeError(d, x), kTolerance);
    ASSERT_TRUE(factor.Refactor());
    ExpectEqualsDense(factor, mirror);
  }
}

TEST(BlockCholesky, SingularUpdateChangesNothing) {
  Random rng(9);
  BlockCholesky<6> factor;
  Mirror<6> mirror;
  BlockCholesky<6>::Changes changes;
  changes.new_variables = mirror.variables = 5;
  for (int v = 0; v < 5; ++v) {
    changes.added.push_back(RandomFactor<6>(rng, v, -1));
    if (v > 0) changes.added.push_back(RandomFactor<6>(rng, v - 1, v));
  }
  for (std::size_t k = 0; k < changes.added.size(); ++k) mirror.by_slot[static_cast<int>(k)] = changes.added[k];
  ASSERT_TRUE(factor.Update(changes).ok);

  // A new variable that nothing measures, along with other changes.
  BlockCholesky<6>::Changes bad;
  bad.new_variables = 1;
  bad.added.push_back(RandomFactor<6>(rng, 0, 3));
  bad.removed.push_back(0);
  bad.replaced.emplace_back(1, RandomFactor<6>(rng, 1, -1));
  bad.replaced.back().second.first = mirror.by_slot[1].first;
  bad.replaced.back().second.second = mirror.by_slot[1].second;
  const auto report = factor.Update(bad);
  EXPECT_FALSE(report.ok);
  EXPECT_EQ(report.failed_variable, 5);
  EXPECT_EQ(factor.Variables(), 5);
  ExpectEqualsDense(factor, mirror);
  ExpectSoundTree(factor);

  // And it goes on from there.
  BlockCholesky<6>::Changes good;
  good.added.push_back(RandomFactor<6>(rng, 0, 3));
  const auto after = factor.Update(good);
  ASSERT_TRUE(after.ok);
  mirror.by_slot[after.added_slots[0]] = good.added[0];
  ExpectEqualsDense(factor, mirror);
}

// A H^-1 A' of many factors at once, which may share all of their paths or none.
template <int B>
void ExpectJointGram(std::uint64_t seed, int trees) {
  constexpr int kVariables = 80;  // enough for fronts with several children
  Random rng(seed);
  BlockCholesky<B> cholesky;
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = kVariables;
  testing::DenseSystem dense{Eigen::MatrixXd::Zero(kVariables * B, kVariables * B),
                             Eigen::VectorXd::Zero(kVariables * B)};
  for (int v = 0; v < kVariables; ++v) {
    changes.added.push_back(RandomFactor<B>(rng, v, -1));
    const int place = v % (kVariables / trees);
    if (place > 0) {
      const int before = v - 1 - static_cast<int>(rng() % static_cast<std::uint64_t>(place));
      changes.added.push_back(RandomFactor<B>(rng, before, v));
    }
  }
  for (const auto& f : changes.added) AddDense(dense, f);
  ASSERT_TRUE(cholesky.Update(changes).ok);
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(6 * B, kVariables * B);
  std::vector<internal::PathColumns<B>> columns;
  std::vector<const internal::PathColumns<B>*> all;
  for (int k = 0; k < 6; ++k) {
    const int first = static_cast<int>(rng() % kVariables),
              second = (first + 1 + static_cast<int>(rng() % (kVariables - 1))) % kVariables;
    const LinearFactor<B> f = RandomFactor<B>(rng, first, second);
    A.block<B, B>(k * B, first * B) = f.A_first;
    A.block<B, B>(k * B, second * B) = f.A_second;
    columns.push_back(internal::SolveForward(cholesky.Tree(), f));
  }
  for (const auto& z : columns) all.push_back(&z);
  const Eigen::MatrixXd expected = A * dense.H.llt().solve(A.transpose());
  EXPECT_LT((internal::JointGram<B>(all) - expected).norm(), kTolerance * expected.norm());
  for (int k = 0; k < 6; ++k) {
    const Matrix<B, B> gram = internal::Gram<B>(columns[0], columns[static_cast<std::size_t>(k)]);
    EXPECT_LT((gram - expected.block<B, B>(0, k * B)).norm(), kTolerance * expected.norm());
  }
  const Vector<B> q = Vector<B>::NullaryExpr([&] { return testing::Normal(rng); });
  const std::vector<double> x = internal::SolveBackward<B>(cholesky.Tree(), columns[0], q);
  const Eigen::VectorXd dense_x = dense.H.llt().solve(A.topRows<B>().transpose() * q);
  ASSERT_EQ(x.size(), static_cast<std::size_t>(dense_x.size()));
  EXPECT_LT((Eigen::Map<const Eigen::VectorXd>(x.data(), dense_x.size()) - dense_x).norm(),
            kTolerance * dense_x.norm());
  // More of them, all of which reach the root of the single tree.
  if (trees == 1) {
    for (int copies = 0; copies < 4; ++copies) all.push_back(all[static_cast<std::size_t>(copies)]);
    const Eigen::MatrixXd more = internal::JointGram<B>(all);
    EXPECT_LT((more.topLeftCorner(6 * B, 6 * B) - expected).norm(), kTolerance * expected.norm());
    EXPECT_LT((more.bottomRightCorner(4 * B, 4 * B) - expected.topLeftCorner(4 * B, 4 * B)).norm(),
              kTolerance * expected.norm());
    EXPECT_EQ(more, more.transpose().eval());
  }
}

TEST(BlockCholesky, JointGramIsThatOfTheDenseInverse) {
  for (const std::uint64_t seed : testing::Seeds(1, 5)) {
    for (const int trees : {1, 2}) {
      ExpectJointGram<3>(seed, trees);
      ExpectJointGram<6>(seed, trees);
    }
  }
}

TEST(BlockCholesky, ThresholdBoundsTheErrorOfTheSolution) {
  Random rng(11);
  BlockCholesky<3> factor;
  Mirror<3> mirror;
  for (int v = 0; v < 60; ++v) {
    BlockCholesky<3>::Changes changes;
    changes.new_variables = 1;
    changes.added.push_back(RandomFactor<3>(rng, v, -1));
    if (v > 0) changes.added.push_back(RandomFactor<3>(rng, v - 1, v));
    const auto report = factor.Update(changes);
    ASSERT_TRUE(report.ok);
    for (std::size_t k = 0; k < changes.added.size(); ++k) mirror.by_slot[report.added_slots[k]] = changes.added[k];
    mirror.variables = v + 1;
    factor.Solve(1e-3);
    const auto dense = mirror.Dense();
    const Eigen::VectorXd x = testing::Solve(dense.H, dense.b);
    const Eigen::Map<const Eigen::VectorXd> d(factor.Solution().data(), x.size());
    // A value stays behind by at most the threshold, seen from separators that stay behind likewise.
    EXPECT_LT((d - x).cwiseAbs().maxCoeff(), 0.1);
  }
}

// Fronts that grow leave buffers behind of sizes that are not asked for again.
TEST(BufferPool, HoldsAFewTimesItsLargestBuffer) {
  internal::BufferPool pool;
  std::size_t given = 0, largest = 0;
  for (std::size_t size = 1000; size < 1000000; size += size / 8) {
    for (int k = 0; k < 4; ++k) {
      internal::FrontBuffer buffer = pool.Take(size);
      ASSERT_GE(buffer.size(), size);
      EXPECT_LE(buffer.size(), size + 3 * size / 8 + 1);
      largest = std::max(largest, buffer.size());
      given += buffer.size();
      pool.MakeRoom(buffer.size());
      internal::FrontBuffer another(buffer.size());
      pool.Give(std::move(buffer));
      pool.Give(std::move(another));
      EXPECT_LE(pool.Scalars(), std::max<std::size_t>(4 * largest, 1 << 20));
    }
  }
  EXPECT_GT(given, 8 * largest);
  EXPECT_GT(pool.Scalars(), largest);
  // What was given last is given out first, and not twice.
  const std::size_t before = pool.Scalars();
  const internal::FrontBuffer taken = pool.Take(largest);
  EXPECT_EQ(pool.Scalars(), before - taken.size());
  EXPECT_EQ(internal::BufferPool(pool).Scalars(), 0u);
  internal::BufferPool moved(std::move(pool));
  EXPECT_EQ(moved.Scalars(), before - taken.size());
  moved = internal::BufferPool();
  EXPECT_EQ(moved.Scalars(), 0u);
}

}  // namespace
}  // namespace terse
