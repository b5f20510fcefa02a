// Contests of loops against batch least squares on all subsets.

#include "terse/core/loop_contest.h"

#include <gtest/gtest.h>

#include "testing.h"

namespace terse {
namespace {

using internal::Contest;
using std::size_t;
constexpr int kB = 3;
constexpr double kWidth = 3.4;

// Loops r + A x on x with the prior information H: what is least over x, and which are in.
struct Problem {
  Eigen::MatrixXd H, A;
  Eigen::VectorXd r;

  static Problem Make(testing::Random& rng, int loops, int variables) {
    std::normal_distribution<double> normal;
    const auto draw = [&](Eigen::Index rows, Eigen::Index columns) {
      return Eigen::MatrixXd(Eigen::MatrixXd::NullaryExpr(rows, columns, [&] { return normal(rng); }));
    };
    const Eigen::MatrixXd root = draw(variables, variables);
    Problem p;
    p.H = root.transpose() * root + 0.1 * Eigen::MatrixXd::Identity(variables, variables);
    p.A = draw(kB * loops, variables);
    p.r = 4 * draw(kB * loops, 1);
    return p;
  }
  size_t Loops() const { return static_cast<size_t>(r.size() / kB); }
  Eigen::MatrixXd Rows(const std::vector<char>& in, Eigen::VectorXd& residual) const {
    std::vector<Eigen::Index> rows;
    for (size_t i = 0; i < in.size(); ++i) {
      for (int b = 0; in[i] != 0 && b < kB; ++b) rows.push_back(static_cast<Eigen::Index>(i) * kB + b);
    }
    residual = r(rows);
    return A(rows, Eigen::all);
  }
  double Cost(const std::vector<char>& in) const {
    Eigen::VectorXd b;
    const Eigen::MatrixXd J = Rows(in, b);
    const Eigen::VectorXd x = -(H + J.transpose() * J).ldlt().solve(J.transpose() * b);
    const auto out = static_cast<double>(std::count(in.begin(), in.end(), 0));
    return x.dot(H * x) + (J * x + b).squaredNorm() + out * kWidth * kWidth;
  }
  // As the map sees them when some are in.
  Contest<kB> Start(const std::vector<char>& in) const {
    Eigen::VectorXd b;
    const Eigen::MatrixXd J = Rows(in, b);
    const Eigen::MatrixXd sigma = (H + J.transpose() * J).inverse();
    const Eigen::VectorXd x = -sigma * (J.transpose() * b);
    return {A * x + r, A * sigma * A.transpose(), in, kWidth};
  }
};

TEST(LoopContest, FlipsCostWhatLeastSquaresSays) {
  for (const std::uint64_t seed : testing::Seeds(1, 5)) {
    SCOPED_TRACE(seed);
    testing::Random rng(seed);
    const Problem problem = Problem::Make(rng, 8, 12);
    std::vector<char> in(problem.Loops());
    for (char& x : in) x = static_cast<char>(rng() % 2);
    Contest<kB> contest = problem.Start(in);
    const double before = problem.Cost(in);
    for (int k = 0; k < 40; ++k) {
      const size_t i = rng() % in.size();
      const double now = problem.Cost(contest.In()), innovation = contest.Innovation(i);
      const bool was_in = contest.In()[i] != 0;
      ASSERT_TRUE(contest.Flip(i));
      in[i] ^= 1;
      ASSERT_EQ(contest.In(), in);
      EXPECT_NEAR(contest.Cost(), problem.Cost(in) - before, 1e-7 * before);
      EXPECT_NEAR(problem.Cost(in) - now, (was_in ? -1 : 1) * (innovation - kWidth * kWidth), 1e-7 * before);
    }
  }
}

TEST(LoopContest, GroupsAreWorthWhatTheirLoopsCost) {
  for (const std::uint64_t seed : testing::Seeds(11, 15)) {
    SCOPED_TRACE(seed);
    testing::Random rng(seed);
    const Problem problem = Problem::Make(rng, 8, 12);
    std::vector<char> in(problem.Loops(), 1), without = in;
    in[3] = 0;
    without = in;
    const std::vector<size_t> group = {1, 3, 4, 6};  // one is out already
    for (const size_t i : group) without[i] = 0;
    EXPECT_NEAR(problem.Start(in).WorthOfLeaving(group), problem.Cost(in) - problem.Cost(without), 1e-8);
    EXPECT_EQ(problem.Start(without).WorthOfLeaving(group), 0);
    Contest<kB> contest = problem.Start(in);
    contest.DescendByGroups({{0}, group, {2, 5}});
    EXPECT_LE(problem.Cost(contest.In()), std::min(problem.Cost(in), problem.Cost(without)) + 1e-8);
  }
}

TEST(LoopContest, SomeOfThemDoAsAmongAll) {
  testing::Random rng(41);
  const Problem problem = Problem::Make(rng, 8, 12);
  Contest<kB> all = problem.Start({0, 1, 0, 1, 1, 0, 1, 0});
  all.SetPrice(6, 3 * kWidth);
  ASSERT_TRUE(all.Flip(2));
  ASSERT_TRUE(all.Flip(4));
  const double before = all.Cost();
  const std::vector<size_t> some = {6, 2, 3};
  Contest<kB> among = all.Among(some);
  ASSERT_EQ(among.In(), (std::vector<char>{1, 1, 1}));
  for (const size_t k : {size_t{0}, size_t{1}, size_t{2}, size_t{0}}) {
    ASSERT_TRUE(among.Flip(k));
    ASSERT_TRUE(all.Flip(some[k]));
    EXPECT_NEAR(among.Cost(), all.Cost() - before, 1e-9);
    for (size_t i = 0; i < some.size(); ++i) EXPECT_NEAR(among.Innovation(i), all.Innovation(some[i]), 1e-9);
  }
}

// No single flip is better than where it ends, and graduation ends no worse than nothing.
TEST(LoopContest, DescentEndsInAMinimum) {
  for (const std::uint64_t seed : testing::Seeds(21, 25)) {
    SCOPED_TRACE(seed);
    testing::Random rng(seed);
    const Problem problem = Problem::Make(rng, 7, 9);
    const std::vector<char> none(problem.Loops(), 0);
    for (const bool graduates : {false, true}) {
      Contest<kB> contest = problem.Start(none);
      if (graduates) {
        ASSERT_TRUE(contest.Graduate(1.4));
      }
      contest.Descend();
      std::vector<char> in = contest.In();
      const double cost = problem.Cost(in);
      EXPECT_LE(cost, problem.Cost(none) + 1e-8);
      for (char& x : in) {
        x ^= 1;
        EXPECT_GE(problem.Cost(in), cost - 1e-6);
        x ^= 1;
      }
    }
  }
}

}  // namespace
}  // namespace terse
