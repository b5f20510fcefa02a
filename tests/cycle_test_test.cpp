// Loops against odometry alone: its covariances against those of a dense chain, and what it saves where covariances say
// nothing.

#include "terse/core/cycle_test.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include "terse/core/incremental_solver.h"
#include "terse/core/replay.h"
#include "testing.h"
#include "testing_laps.h"

namespace terse {
namespace {

using internal::CycleTest;
using testing::Random;

template <class Pose>
class CycleTestOf : public ::testing::Test {};
using Poses = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CycleTestOf, Poses);

template <class Pose>
RelativePoseFactor<Pose> RandomEdge(int from, int to, Random& rng) {
  return {PoseId{from}, PoseId{to}, testing::RandomMotion<Pose>(rng, 1, 0.5),
          testing::RandomInformation<Pose::kDof>(rng)};
}
template <class Pose>
RelativePoseFactor<Pose> Reversed(const RelativePoseFactor<Pose>& edge) {
  // (T Exp(d))^-1 = T^-1 Exp(-Ad(T) d)
  const typename Pose::Jacobian Ad = edge.T_from_to.Inverse().Adjoint();
  return {edge.to, edge.from, edge.T_from_to.Inverse(), Ad.transpose() * edge.information * Ad};
}

// By composition, edge after edge: covariances of `to`, each moved on by the adjoint of what follows.
template <class Pose>
double ComposedInnovation(const std::vector<RelativePoseFactor<Pose>>& odometry, int from, int to,
                          const RelativePoseFactor<Pose>& loop) {
  Pose T;
  typename Pose::Jacobian covariance = Pose::Jacobian::Zero();
  for (int k = from; k < to; ++k) {
    const auto& edge = odometry[static_cast<std::size_t>(k)];
    const typename Pose::Jacobian Ad = edge.T_from_to.Inverse().Adjoint();
    covariance = (Ad * covariance * Ad.transpose() + edge.information.inverse()).eval();
    T = T * edge.T_from_to;
  }
  const typename Pose::Tangent error = (loop.T_from_to.Inverse() * T).Log();
  covariance += loop.information.inverse();
  return error.dot(covariance.ldlt().solve(error));
}

TYPED_TEST(CycleTestOf, InnovationIsThatOfTheComposedChain) {
  for (const std::uint64_t seed : testing::Seeds(1, 5)) {
    Random rng(seed);
    CycleTest<TypeParam> cycles;
    std::vector<RelativePoseFactor<TypeParam>> odometry;
    for (int k = 0; k < 40; ++k) {
      odometry.push_back(RandomEdge<TypeParam>(k, k + 1, rng));
      cycles.Extend(k % 3 == 1 ? Reversed(odometry.back()) : odometry.back());
    }
    for (int trial = 0; trial < 50; ++trial) {
      const int from = static_cast<int>(rng() % 30), to = from + 1 + static_cast<int>(rng() % 10);
      const auto loop = RandomEdge<TypeParam>(from, to, rng);
      const double expected = ComposedInnovation(odometry, from, to, loop);
      ASSERT_TRUE(cycles.Innovation(loop));
      EXPECT_NEAR(*cycles.Innovation(loop), expected, 1e-8 * (1 + expected)) << seed << ": " << from << " - " << to;
      // Seen from its other end it is the same measurement, as far as errors are small.
      auto close = loop;
      close.T_from_to = TypeParam();
      for (int k = from; k < to; ++k)
        close.T_from_to = close.T_from_to * odometry[static_cast<std::size_t>(k)].T_from_to;
      close.T_from_to = close.T_from_to * testing::RandomMotion<TypeParam>(rng, 1e-3, 1e-3);
      const double one_way = cycles.Innovation(close).value();
      EXPECT_NEAR(cycles.Innovation(Reversed(close)).value(), one_way, 0.02 * one_way);
    }
  }
}

TYPED_TEST(CycleTestOf, NothingLeadsOverWhatIsBrokenOrMissing) {
  Random rng(3);
  CycleTest<TypeParam> cycles;
  const auto extend = [&](int from, int to) { cycles.Extend(RandomEdge<TypeParam>(from, to, rng)); };
  const auto knows = [&](int a, int b) { return cycles.Innovation(RandomEdge<TypeParam>(a, b, rng)).has_value(); };
  for (int k = 0; k < 10; ++k) extend(k, k + 1);
  extend(4, 11);  // a branch
  extend(11, 12);
  EXPECT_TRUE(knows(0, 10));
  EXPECT_TRUE(knows(11, 12));
  EXPECT_FALSE(knows(4, 12));
  EXPECT_FALSE(knows(0, 99));
  cycles.Break(PoseId{6});
  EXPECT_TRUE(knows(0, 5));
  EXPECT_TRUE(knows(6, 10));
  EXPECT_FALSE(knows(5, 6));
  extend(12, 13);
  cycles.Retract(PoseId{12});
  EXPECT_FALSE(knows(12, 13));
  extend(12, 14);
  EXPECT_TRUE(knows(11, 14));
}

TYPED_TEST(CycleTestOf, PosesThatAreGoneAreForgotten) {
  Random rng(4);
  CycleTest<TypeParam> cycles;
  const auto is_there = [](PoseId id) { return id.value % 100 == 0; };
  for (int k = 0; k < 5000; ++k) {
    cycles.Extend(RandomEdge<TypeParam>(k, k + 1, rng));
    cycles.Forget(is_there);
  }
  EXPECT_FALSE(cycles.Innovation(RandomEdge<TypeParam>(1, 5000, rng)));
  EXPECT_TRUE(cycles.Innovation(RandomEdge<TypeParam>(100, 5000, rng)));
}

// A unit matrix for information, loops where the robot came back, and half as many wrong ones: the first of these bend
// the map at no cost, before any true one has come.
TYPED_TEST(CycleTestOf, UnitInformationDoesNotLetWrongLoopsIn) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    const auto [graph, truth, wrong] = testing::TwoLaps<TypeParam>(seed, 20);
    IncrementalOptions options;
    options.robust.kernel = RobustKernel::kGnc;
    IncrementalSolver<TypeParam> solver(options);
    Replay<TypeParam>(graph, {}, solver);
    const BatchResult<TypeParam> result = solver.Finish();
    ASSERT_EQ(result.T_world_body.size(), truth.size());
    double worst = 0;
    for (std::size_t k = 0; k < truth.size(); ++k) {
      const TypeParam T_true_found =
          (truth[0].Inverse() * truth[k]).Inverse() * (result.T_world_body[0].Inverse() * result.T_world_body[k]);
      worst = std::max(worst, T_true_found.Log().template head<TypeParam::kDim>().norm());
    }
    EXPECT_LT(worst, 5) << "seed " << seed << ", " << wrong << " wrong loops; a lap is 300 m long";
  }
}

}  // namespace
}  // namespace terse
