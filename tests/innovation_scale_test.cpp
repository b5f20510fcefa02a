// The scale of innovations, out of draws with wrong ones among them.

#include "terse/core/innovation_scale.h"

#include <gtest/gtest.h>

#include "terse/core/chi_square.h"
#include "testing.h"

namespace terse {
namespace {

using internal::InnovationScale;

double DrawChiSquare(testing::Random& rng, int dof) {
  std::normal_distribution<double> normal;
  double sum = 0;
  for (int k = 0; k < dof; ++k) {
    const double x = normal(rng);
    sum += x * x;
  }
  return sum;
}

// Bins are a quarter of an octave wide.
constexpr double kBin = 1.2;

TEST(InnovationScale, FewSayNothing) {
  InnovationScale scale;
  EXPECT_EQ(scale.Limit(11.3, 3), 11.3);
  for (int k = 0; k < 15; ++k) {
    scale.Add(1e-6);
    EXPECT_EQ(scale.Limit(11.3, 3), 11.3) << k;
  }
}

TEST(InnovationScale, RightInformationKeepsItsLimit) {
  for (const std::uint64_t seed : testing::Seeds(1, 20)) {
    testing::Random rng(seed);
    for (const int dof : {3, 6}) {
      const double stated = ChiSquareQuantile(0.99, dof);
      InnovationScale scale;
      for (int k = 0; k < 300; ++k) {
        scale.Add(std::min(stated, DrawChiSquare(rng, dof)));
        EXPECT_EQ(scale.Limit(stated, dof), stated) << "seed " << seed << ", after " << k;
      }
    }
  }
}

// Six times the quantile of what loops show, whatever a third of them, wrong ones, say.
TEST(InnovationScale, FollowsTheMedianOfCautiousInformation) {
  for (const std::uint64_t seed : testing::Seeds(1, 10)) {
    testing::Random rng(seed);
    for (const double variance : {0.03, 0.01, 0.003}) {
      const double stated = ChiSquareQuantile(0.99, 3);
      InnovationScale scale, contaminated;
      for (int k = 0; k < 2000; ++k) {
        const double innovation = variance * DrawChiSquare(rng, 3);
        scale.Add(innovation);
        const bool is_wrong = rng() % 3 == 0;
        contaminated.Add(is_wrong ? std::uniform_real_distribution<double>(0, stated)(rng) : innovation);
      }
      // Four standard errors of the middle rank: the 0.545 quantile in place of the median.
      const double expected = 6 * variance * ChiSquareQuantile(0.545, 3) / ChiSquareQuantile(0.5, 3) * stated;
      EXPECT_NEAR(std::log(scale.Limit(stated, 3) / expected), 0, std::log(1.15 * kBin)) << "variance " << variance;
      // The median is then what three quarters of the true ones do not exceed.
      EXPECT_LT(contaminated.Limit(stated, 3), std::min(stated, 3 * expected)) << "variance " << variance;
    }
  }
}

// A robot that stands still closes perfect loops; what comes later is not refused for ever.
TEST(InnovationScale, RecoversFromLoopsThatWereTooGood) {
  testing::Random rng(7);
  InnovationScale scale;
  const double stated = ChiSquareQuantile(0.99, 6);
  for (int k = 0; k < 100; ++k) scale.Add(1e-9);
  EXPECT_NEAR(scale.Limit(stated, 6), 1e-3 * stated, 1e-12) << "never below a thousandth";
  for (int k = 0; k < 300; ++k) scale.Add(std::min(stated, DrawChiSquare(rng, 6)));
  EXPECT_EQ(scale.Limit(stated, 6), stated);
}

}  // namespace
}  // namespace terse
