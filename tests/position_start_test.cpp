// Starts from odometry that drifted far, with position priors along the way.

#include <gtest/gtest.h>

#include "terse/core/batch_solver.h"
#include "terse/core/initial_values.h"
#include "terse/core/position_start.h"
#include "testing.h"

namespace terse {
namespace {

template <class Pose>
class PositionStartTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(PositionStartTest, Groups);

constexpr int kPosesOfDrive = 1000, kFixes = 300;
constexpr double kDegree = M_PI / 180;

// A winding road, a metre per pose; odometry with 3 cm and half a degree per step, systematic or at random, and fixes
// with 1 m.
template <class Pose>
struct StartDrive {
  StartDrive(std::uint64_t seed, bool systematic) {
    constexpr int B = Pose::kDof, D = Pose::kDim;
    testing::Random rng(seed);
    Vector<B> sigma = Vector<B>::Constant(0.03);
    sigma.template tail<B - D>().setConstant(0.5 * kDegree);
    const typename Pose::Jacobian information = sigma.cwiseAbs2().cwiseInverse().asDiagonal();
    for (int k = 0; k < kPosesOfDrive; ++k) {
      typename Pose::Tangent step = Pose::Tangent::Zero();
      step[0] = 1;
      step[B - 1] = 0.05 * std::sin(0.02 * k);
      if (D == 3) step[D + 1] = 0.005 * std::cos(0.05 * k);
      truth.push_back(k == 0 ? Pose() : truth.back() * Pose().Retract(step));
      graph.AddPose(PoseId{k}, k == 0 ? std::optional<Pose>(Pose()) : std::nullopt);
      if (k == 0) continue;
      typename Pose::Tangent noise = testing::NormalVector<B>(rng).cwiseProduct(sigma);
      if (systematic) noise[B - 1] = 0.5 * kDegree;
      graph.AddFactor(RelativePoseFactor<Pose>{PoseId{k - 1}, PoseId{k}, Pose().Retract(step) * Pose().Retract(noise),
                                               information});
    }
    for (int f = 0; f < kFixes; ++f) {
      const int k = f * (kPosesOfDrive - 1) / (kFixes - 1);
      const typename Pose::Position p = truth[std::size_t(k)].Translation() + testing::NormalVector<D>(rng);
      graph.AddFactor(PositionPriorFactor<Pose>{PoseId{k}, p, Matrix<D, D>::Identity()});
    }
  }
  double Error(const std::vector<Pose>& values) const {
    double sum = 0;
    for (std::size_t k = 0; k < values.size(); ++k)
      sum += (values[k].Translation() - truth[k].Translation()).squaredNorm();
    return std::sqrt(sum / static_cast<double>(values.size()));
  }
  PoseGraph<Pose> graph;
  std::vector<Pose> truth;
};

TYPED_TEST(PositionStartTest, OptimisationConvergesFromTheComposedStart) {
  using Pose = TypeParam;
  for (const bool systematic : {false, true}) {
    for (std::uint64_t seed = 1; seed <= 2; ++seed) {
      SCOPED_TRACE((systematic ? "systematic " : "random ") + std::to_string(seed));
      const StartDrive<Pose> drive(seed, systematic);
      const auto start = ComputeInitialValues(drive.graph, InitialValues::kCompose);
      const auto result = SolveBatch(drive.graph, start);
      const auto best = SolveBatch(drive.graph, drive.truth);
      ASSERT_TRUE(best.Converged());
      EXPECT_TRUE(result.Converged()) << result.message;
      EXPECT_LT(result.iterations, 50);
      EXPECT_NEAR(result.chi2, best.chi2, 1e-6 * best.chi2);
      std::printf("error %.1f m at the start, %.3f m at the end after %d iterations\n", drive.Error(start),
                  drive.Error(result.T_world_body), result.iterations);
    }
  }
}

TYPED_TEST(PositionStartTest, TheLeastChi2Wins) {
  using Pose = TypeParam;
  const StartDrive<Pose> drive(3, true);
  std::vector<int> order(kPosesOfDrive);
  for (int k = 0; k < kPosesOfDrive; ++k) order[std::size_t(k)] = k;
  std::vector<Pose> values = drive.truth;
  EXPECT_NE(internal::MoveToPositionPriors(drive.graph, order, values), internal::PositionStart::kPiecewise)
      << "the truth is smooth";
  EXPECT_LT(drive.Error(values), 1);
  // Without priors nothing moves.
  PoseGraph<Pose> plain;
  plain.AddPose(PoseId{0});
  std::vector<Pose> one(1);
  EXPECT_EQ(internal::MoveToPositionPriors(plain, {0}, one), internal::PositionStart::kAsComposed);
}

// FIX holds its pose where it is, whatever the stretches do.
TYPED_TEST(PositionStartTest, AFixedPoseKeepsItsValue) {
  using Pose = TypeParam;
  StartDrive<Pose> drive(4, true);
  drive.graph.SetFixed(PoseId{0}, true);
  const auto start = ComputeInitialValues(drive.graph, InitialValues::kCompose);
  EXPECT_EQ(start[0].Local(Pose()).norm(), 0);
  const auto result = SolveBatch(drive.graph, start);
  EXPECT_TRUE(result.Converged()) << result.message;
  EXPECT_LT(result.iterations, 50);
}

}  // namespace
}  // namespace terse
