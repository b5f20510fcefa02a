// Short cycles and the probability of measurements: against closed forms and simulation.

#include "terse/covariance/scale_evidence.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "terse/core/batch_solver.h"
#include "terse/covariance/short_cycles.h"
#include "testing.h"

namespace terse::internal {
namespace {

constexpr double kSigma = 0.01;

// Two passes over the same way; of each group of loops `wrong` in ten lead elsewhere.
template <class Pose>
struct Passes {
  std::vector<ProbeTerm<Pose>> terms;
  std::vector<char> is_loop;
  std::vector<Pose> truth;
};

template <class Pose>
Passes<Pose> MakePasses(std::uint64_t seed, int poses, double noise, int wrong) {
  testing::Random random(seed);
  Passes<Pose> passes;
  typename Pose::Tangent twist = Pose::Tangent::Zero();
  twist[0] = 1;
  twist[Pose::kDof - 1] = 0.01;
  for (int k = 0; k < 2 * poses; ++k)
    passes.truth.push_back(k % poses == 0 ? Pose() : passes.truth.back() * Pose::Exp(twist));
  const typename Pose::Jacobian information = Pose::Jacobian::Identity() / (kSigma * kSigma);
  const auto add = [&](int from, int to, const Pose& T, bool is_loop) {
    const Pose measured = T * Pose::Exp(noise * kSigma * testing::NormalVector<Pose::kDof>(random));
    passes.terms.push_back({from, to, RelativePoseFactor<Pose>{{from}, {to}, measured, information}, 1});
    passes.is_loop.push_back(is_loop);
  };
  const auto way = [&](int from, int to) {
    return passes.truth[static_cast<std::size_t>(from)].Inverse() * passes.truth[static_cast<std::size_t>(to)];
  };
  for (int k = 1; k < 2 * poses; ++k) {
    add(k - 1, k, way(k - 1, k), false);
    if (k < poses || k % 2 != 0) continue;
    if (k % 10 < wrong) {
      const int from = static_cast<int>(random() % static_cast<unsigned>(poses));
      add(from, k, testing::RandomMotion<Pose>(random, 5, 1), true);
    } else if (k % 20 < 10) {
      add(k - poses, k, way(k - poses, k), true);
    } else {  // the other way round
      add(k, k - poses, way(k, k - poses), true);
    }
  }
  return passes;
}

template <class Pose>
PoseGraph<Pose> GraphOf(const std::vector<ProbeTerm<Pose>>& terms, std::size_t poses) {
  PoseGraph<Pose> graph;
  for (std::size_t k = 0; k < poses; ++k) graph.AddPose({static_cast<int>(k)});
  for (const auto& term : terms) graph.AddFactor(term.factor);
  return graph;
}

template <class Pose>
class ScaleEvidence : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ScaleEvidence, Groups);

// However many loops are wrong.
TYPED_TEST(ScaleEvidence, ShortCyclesTellTheScale) {
  using Pose = TypeParam;
  for (const double noise : {0.2, 1.0, 20.0}) {
    for (const int wrong : {0, 6}) {
      const auto passes = MakePasses<Pose>(5, 400, noise, wrong);
      const auto loops = ForwardEdges(passes.terms, passes.is_loop);
      const auto cycles = ShortCycles(loops, OdometryChain<Pose>(ForwardEdges(passes.terms), passes.truth.size()));
      const auto scale = ScaleOfShortCycles<Pose>(cycles);
      ASSERT_TRUE(scale);
      EXPECT_NEAR(std::log(scale->translation / noise), 0, std::log(1.5)) << noise << ", wrong " << wrong;
      EXPECT_NEAR(std::log(scale->rotation / noise), 0, std::log(1.5)) << noise << ", wrong " << wrong;
    }
  }
  const auto few = MakePasses<Pose>(5, 10, 1, 0);
  const auto loops = ForwardEdges(few.terms, few.is_loop);
  EXPECT_FALSE(
      ScaleOfShortCycles<Pose>(ShortCycles(loops, OdometryChain<Pose>(ForwardEdges(few.terms), few.truth.size()))));
}

// One factor s on all standard deviations changes the cost by chi2 (s^-2 - 1) / 2 + r log s, r the redundancy.
TYPED_TEST(ScaleEvidence, HasTheClosedFormOfOneScale) {
  using Pose = TypeParam;
  const auto passes = MakePasses<Pose>(7, 60, 1, 0);
  const auto solved_at = [&](double scale) {
    auto terms = passes.terms;
    for (auto& term : terms) term.factor.information /= scale * scale;
    BatchOptions options;
    options.robust.kernel = RobustKernel::kGnc;  // for the weights
    options.robust.width = 1e6;
    const auto solved = SolveBatch(GraphOf(terms, passes.truth.size()), passes.truth, options);
    return std::pair(CostOfScales(terms, passes.is_loop, solved), solved.chi2);
  };
  const auto [cost, chi2] = solved_at(1);
  const double redundancy =
      Pose::kDof * (static_cast<double>(passes.terms.size()) - static_cast<double>(passes.truth.size()) + 1);
  for (const double scale : {0.3, 2.0, 10.0}) {
    const double expected = chi2 / 2 * (1 / (scale * scale) - 1) + redundancy * std::log(scale);
    EXPECT_NEAR(solved_at(scale).first - cost, expected, 1e-4 * std::abs(expected)) << scale;
  }
}

// Whatever is wrong, at scales that fit and at ones that do not.
TYPED_TEST(ScaleEvidence, NoChoiceOfWrongLoopsCostsLess) {
  using Pose = TypeParam;
  for (const std::uint64_t seed : testing::Seeds(11, 14)) {
    const auto passes = MakePasses<Pose>(seed, 60, 1, 3);
    double above = 0;
    for (const double scale : {0.1, 0.5, 1.0, 5.0, 40.0}) {
      auto terms = passes.terms;
      for (auto& term : terms) term.factor.information /= scale * scale;
      const double least = LeastCostOfScales(terms, passes.is_loop);
      for (const double width : {0.1, 3.0, 1e6}) {
        BatchOptions options;
        options.robust.kernel = RobustKernel::kGnc;
        options.robust.width = width;
        options.robust_factors = LoopFactors(GraphOf(terms, passes.truth.size()));
        const auto solved = SolveBatch(GraphOf(terms, passes.truth.size()), passes.truth, options);
        const double cost = CostOfScales(terms, passes.is_loop, solved);
        EXPECT_LE(least, cost) << "seed " << seed << ", scale " << scale << ", width " << width;
        above = std::max(above, least);
      }
    }
    // It tells something: at a scale far too large it is more than the right one costs without wrong loops.
    const auto right = MakePasses<Pose>(seed, 60, 1, 0);
    BatchResult<Pose> solved = SolveBatch(GraphOf(right.terms, right.truth.size()), right.truth, BatchOptions());
    solved.weights.assign(right.terms.size(), 1);
    EXPECT_GT(above, CostOfScales(right.terms, right.is_loop, solved)) << seed;
    // Where odometry is far better than loops, and nothing is off, it is what they cost, but for the anchor's part.
    auto exact = MakePasses<Pose>(seed, 60, 0, 0);
    for (std::size_t k = 0; k < exact.terms.size(); ++k) {
      if (!exact.is_loop[k]) exact.terms[k].factor.information *= 1e8;
    }
    const auto gap_at = [&](double scale) {
      auto terms = exact.terms;
      for (auto& term : terms) term.factor.information /= scale * scale;
      solved = SolveBatch(GraphOf(terms, exact.truth.size()), exact.truth, BatchOptions());
      solved.weights.assign(terms.size(), 1);
      return CostOfScales(terms, exact.is_loop, solved) - LeastCostOfScales(terms, exact.is_loop);
    };
    EXPECT_GE(gap_at(1), 0) << seed;
    EXPECT_NEAR(gap_at(3), gap_at(1), 0.01) << seed;
    // Nothing where odometry is no chain: a step there twice, one missing, and both.
    const double nothing = -std::numeric_limits<double>::infinity();
    auto twice = passes.terms, missing = passes.terms;
    twice.push_back(twice.front());
    std::vector<char> is_loop = passes.is_loop;
    is_loop.push_back(false);
    EXPECT_EQ(LeastCostOfScales(twice, is_loop), nothing);
    missing.erase(missing.begin() + 5);
    is_loop = passes.is_loop;
    is_loop.erase(is_loop.begin() + 5);
    EXPECT_EQ(LeastCostOfScales(missing, is_loop), nothing);
    missing.push_back(missing.front());
    is_loop.push_back(false);
    EXPECT_EQ(LeastCostOfScales(missing, is_loop), nothing);
  }
}

// A group of wrong loops that agree with each other is one mistake, as many that do not are many.
TYPED_TEST(ScaleEvidence, GroupsAreOneMistake) {
  using Pose = TypeParam;
  auto passes = MakePasses<Pose>(9, 60, 1, 0);
  const auto cost_of = [&](const Pose& shift, const Pose& more) {
    auto terms = passes.terms;
    BatchResult<Pose> solved = SolveBatch(GraphOf(terms, passes.truth.size()), passes.truth, BatchOptions());
    solved.weights.assign(terms.size(), 1);
    int wrong = 0;
    for (std::size_t k = 0; k < terms.size(); ++k) {
      if (!passes.is_loop[k] || terms[k].first > terms[k].second || terms[k].second > 70) continue;
      Pose& T = terms[k].factor.T_from_to;
      T = shift * T * (wrong++ % 2 == 0 ? Pose() : more);
      solved.weights[k] = 0;
    }
    EXPECT_GE(wrong, 4);
    return CostOfScales(terms, passes.is_loop, solved);
  };
  typename Pose::Tangent half = Pose::Tangent::Zero();
  half[0] = 0.5;
  const Pose near = Pose::Exp(half);
  EXPECT_LT(cost_of(near, Pose()) + 10, cost_of(near, near));
}

}  // namespace
}  // namespace terse::internal
