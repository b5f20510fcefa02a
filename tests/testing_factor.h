#pragma once
// A block factor beside the same factors kept densely.

#include <gtest/gtest.h>

#include "terse/core/front_tree.h"
#include "testing.h"

namespace terse::testing {

// Well-conditioned systems of up to 200 scalars: 1e-9 leaves three digits of reserve.
inline constexpr double kTolerance = 1e-9;

template <int B>
LinearFactor<B> RandomFactor(Random& rng, int first, int second) {
  LinearFactor<B> f;
  f.first = first;
  f.second = second;
  for (int c = 0; c < B; ++c) f.A_first.col(c) = NormalVector<B>(rng);
  if (second >= 0) {
    for (int c = 0; c < B; ++c) f.A_second.col(c) = NormalVector<B>(rng);
  }
  f.residual = NormalVector<B>(rng);
  return f;
}

// The same factors, kept densely.
template <int B>
struct Mirror {
  std::map<int, LinearFactor<B>> by_slot;
  int variables = 0;

  DenseSystem Dense() const {
    DenseSystem system{Eigen::MatrixXd::Zero(B * variables, B * variables), Eigen::VectorXd::Zero(B * variables)};
    for (const auto& [slot, f] : by_slot) AddDense(system, f);
    return system;
  }
};

template <int B>
void ExpectEqualsDense(BlockCholesky<B>& factor, const Mirror<B>& mirror, double threshold = 0) {
  const auto dense = mirror.Dense();
  const Eigen::VectorXd x = Solve(dense.H, dense.b);
  factor.Solve(threshold);
  const auto& solution = factor.Solution();
  const Eigen::Map<const Eigen::VectorXd> d(solution.data(), static_cast<Eigen::Index>(solution.size()));
  ASSERT_LT(RelativeError(d, x), kTolerance);
  const double log_det = LogDeterminant(dense.H);
  ASSERT_NEAR(factor.LogDeterminant(), log_det, kTolerance * std::max(1.0, std::abs(log_det)));
  ASSERT_NEAR(factor.NewtonDecrement(), dense.b.dot(x), kTolerance * std::max(1.0, dense.b.dot(x)));
}

// Every separator is a pivot of an ancestor; every variable is a pivot once.
template <int B>
void ExpectSoundTree(const BlockCholesky<B>& factor) {
  std::vector<int> seen(static_cast<std::size_t>(factor.Variables()), 0);
  std::vector<int> stack = factor.Tree().Roots();
  while (!stack.empty()) {
    const int id = stack.back();
    stack.pop_back();
    const auto& front = factor.Tree()[id];
    for (const int v : front.pivots) {
      ++seen[static_cast<std::size_t>(v)];
      ASSERT_EQ(factor.Tree().FrontOf(v), id);
    }
    for (const int v : front.separators) {
      int up = front.parent;
      while (up >= 0 && up != factor.Tree().FrontOf(v)) up = factor.Tree()[up].parent;
      ASSERT_GE(up, 0) << "separator " << v << " is not eliminated above its front";
    }
    for (const int child : front.children) {
      ASSERT_EQ(factor.Tree()[child].parent, id);
      stack.push_back(child);
    }
  }
  for (const int count : seen) ASSERT_EQ(count, 1);
}

// Both at once. Apply changes the mirror only if the factor took the changes.
template <int B>
struct MirroredFactor {
  BlockCholesky<B> factor;
  Mirror<B> mirror;

  typename BlockCholesky<B>::UpdateReport Apply(const typename BlockCholesky<B>::Changes& changes) {
    const auto report = factor.Update(changes);
    if (!report.ok) return report;
    mirror.variables += changes.new_variables;
    for (const int slot : changes.removed) mirror.by_slot.erase(slot);
    for (const auto& [slot, f] : changes.replaced) mirror.by_slot[slot] = f;
    for (std::size_t k = 0; k < changes.added.size(); ++k) mirror.by_slot[report.added_slots[k]] = changes.added[k];
    return report;
  }
};

}  // namespace terse::testing
