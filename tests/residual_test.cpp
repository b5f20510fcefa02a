// Residual Jacobians at non-zero residuals, and chi2 with dense information.

#include "terse/core/residual.h"

#include <gtest/gtest.h>

#include "testing_jacobian.h"
#include "testing_poses.h"

namespace terse {
namespace {

using testing::JacobianMatches;
using testing::kPi;
using testing::PoseRandom;

constexpr int kCases = 2000;
// Central differences with a step of 1e-5 leave 1e-11 times translations of up to some ten metres.
constexpr double kTolerance = 1e-8;

template <class Pose>
class ResidualTest : public ::testing::Test {};
using Poses = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(ResidualTest, Poses);

TYPED_TEST(ResidualTest, RelativeJacobiansMatchCentralDifferences) {
  PoseRandom random(21);
  int checked = 0;
  for (int i = 0; i < kCases; ++i) {
    const auto T_from_to = testing::RandomPose<TypeParam>(random, 2);
    const auto T_world_from = testing::RandomPose<TypeParam>(random, 5);
    const auto T_world_to = testing::RandomPose<TypeParam>(random, 5);
    if ((T_from_to.Inverse() * T_world_from.Inverse() * T_world_to).Angle() > kPi - 1e-4) continue;
    const auto out = EvaluateRelative(T_from_to, T_world_from, T_world_to);
    const auto at = [&](const TypeParam& from, const TypeParam& to) {
      return EvaluateRelative(T_from_to, from, to).residual;
    };
    ASSERT_GT(out.residual.norm(), 1e-3);
    ASSERT_TRUE(JacobianMatches(
        out.J_residual_from, [&](const auto& e) { return at(T_world_from.Retract(e), T_world_to); }, kTolerance));
    ASSERT_TRUE(JacobianMatches(
        out.J_residual_to, [&](const auto& e) { return at(T_world_from, T_world_to.Retract(e)); }, kTolerance));
    ++checked;
  }
  EXPECT_GT(checked, kCases / 2);
}

TYPED_TEST(ResidualTest, PriorJacobianMatchesCentralDifferences) {
  PoseRandom random(22);
  for (int i = 0; i < kCases; ++i) {
    const auto T_measured = testing::RandomPose<TypeParam>(random, 5);
    const auto T_world_body = testing::RandomPose<TypeParam>(random, 5);
    if ((T_measured.Inverse() * T_world_body).Angle() > kPi - 1e-4) continue;
    const auto out = EvaluatePrior(T_measured, T_world_body);
    ASSERT_TRUE(JacobianMatches(
        out.J_residual_pose, [&](const auto& e) { return EvaluatePrior(T_measured, T_world_body.Retract(e)).residual; },
        kTolerance));
  }
}

TYPED_TEST(ResidualTest, PositionJacobianMatchesCentralDifferences) {
  PoseRandom random(23);
  for (int i = 0; i < kCases; ++i) {
    PositionPriorFactor<TypeParam> prior;
    prior.p_world = random.NormalVector<TypeParam::kDim>();
    if (i % 2 == 0) prior.p_body = random.NormalVector<TypeParam::kDim>();
    const auto T_world_body = testing::RandomPose<TypeParam>(random, 5);
    const auto out = EvaluatePosition(prior, T_world_body);
    ASSERT_LT((out.residual - (T_world_body * prior.p_body - prior.p_world)).norm(), 1e-13);
    ASSERT_TRUE(JacobianMatches(
        out.J_residual_pose, [&](const auto& e) { return EvaluatePosition(prior, T_world_body.Retract(e)).residual; },
        kTolerance));
  }
}

TYPED_TEST(ResidualTest, ResidualIsZeroAtTheMeasurementAndMeansWhatTheHeaderSays) {
  PoseRandom random(24);
  for (int i = 0; i < kCases; ++i) {
    const auto T_from_to = testing::RandomPose<TypeParam>(random, 2);
    const auto T_world_from = testing::RandomPose<TypeParam>(random, 5);
    const TypeParam T_world_to = T_world_from * T_from_to;
    // Rounding of translations of some ten metres.
    ASSERT_LT(EvaluateRelative(T_from_to, T_world_from, T_world_to).residual.norm(), 1e-13);
    ASSERT_LT(EvaluatePrior(T_world_to, T_world_to).residual.norm(), 1e-13);
    ASSERT_EQ(
        EvaluatePosition(PositionPriorFactor<TypeParam>{{}, T_world_to.Translation(), {}}, T_world_to).residual.norm(),
        0);
    auto d = testing::RandomTangent<TypeParam>(random, 1);
    d *= 0.5;
    ASSERT_LT((EvaluateRelative(T_from_to, T_world_from, T_world_to.Retract(d)).residual - d).norm(), 1e-13);
    ASSERT_LT((EvaluatePrior(T_world_to, T_world_to.Retract(d)).residual - d).norm(), 1e-13);
  }
}

TEST(ResidualSE2Test, IsTheFormulaOfThePapers) {
  const SE2 Z(0.5, -0.2, 0.3), Ti(1, 2, 3), Tj(-1, 0.5, -2);
  const Vector<2> t =
      Z.Rotation().transpose() * (Ti.Rotation().transpose() * (Tj.Translation() - Ti.Translation()) - Z.Translation());
  const auto r = EvaluateRelative(Z, Ti, Tj).residual;
  EXPECT_NEAR(r[0], t.x(), 1e-15);
  EXPECT_NEAR(r[1], t.y(), 1e-15);
  EXPECT_NEAR(r[2], WrapAngle(-2 - 3 - 0.3), 1e-15);
}

// The sum over all entries, spelt out.
template <class Residual, class Information>
double Quadratic(const Residual& r, const Information& information) {
  double sum = 0;
  for (int i = 0; i < r.size(); ++i) {
    for (int j = 0; j < r.size(); ++j) sum += r[i] * information(i, j) * r[j];
  }
  return sum;
}

TYPED_TEST(ResidualTest, Chi2WeighsWithTheFullInformation) {
  PoseRandom random(25);
  double sum = 0;
  PoseGraph<TypeParam> graph;
  for (int i = 0; i < 20; ++i) graph.AddPose(PoseId{3 * i}, testing::RandomPose<TypeParam>(random, 5));
  const auto value = [&](int i) { return *graph.Poses()[static_cast<std::size_t>(i)].T_world_body; };
  for (int i = 0; i + 1 < 20; ++i) {
    RelativePoseFactor<TypeParam> edge{PoseId{3 * i}, PoseId{3 * i + 3}, testing::RandomPose<TypeParam>(random, 2),
                                       random.Information<TypeParam::kDof>()};
    const double edge_chi2 =
        Quadratic(EvaluateRelative(edge.T_from_to, value(i), value(i + 1)).residual, edge.information);
    EXPECT_NEAR(FactorChi2<TypeParam>(edge, value(i), value(i + 1)), edge_chi2, 1e-13 * edge_chi2);
    PosePriorFactor<TypeParam> prior{PoseId{3 * i}, testing::RandomPose<TypeParam>(random, 2),
                                     random.Information<TypeParam::kDof>()};
    const double prior_chi2 = Quadratic(EvaluatePrior(prior.T_world_body, value(i)).residual, prior.information);
    EXPECT_NEAR(FactorChi2<TypeParam>(prior, value(i), value(i)), prior_chi2, 1e-13 * prior_chi2);
    PositionPriorFactor<TypeParam> position{PoseId{3 * i}, random.NormalVector<TypeParam::kDim>(),
                                            random.Information<TypeParam::kDim>()};
    const double position_chi2 = Quadratic(EvaluatePosition(position, value(i)).residual, position.information);
    EXPECT_NEAR(FactorChi2<TypeParam>(position, value(i), value(i)), position_chi2, 1e-13 * position_chi2);
    graph.AddFactor(edge);
    graph.AddFactor(prior);
    graph.AddFactor(position);
    sum += edge_chi2 + prior_chi2 + position_chi2;
  }
  EXPECT_NEAR(Chi2(graph), sum, 1e-13 * sum);
}

// The gradient of chi2 is 2 J' Omega r: a transposed square root or a swapped Jacobian would show.
TYPED_TEST(ResidualTest, GradientOfChi2) {
  PoseRandom random(26);
  for (int i = 0; i < 200; ++i) {
    const auto T_world_from = testing::RandomPose<TypeParam>(random, 2);
    const auto T_world_to = testing::RandomPose<TypeParam>(random, 2);
    const RelativePoseFactor<TypeParam> edge{PoseId{0}, PoseId{1}, testing::RandomPose<TypeParam>(random, 2),
                                             random.Information<TypeParam::kDof>()};
    if ((edge.T_from_to.Inverse() * T_world_from.Inverse() * T_world_to).Angle() > kPi - 1e-4) continue;
    const auto out = EvaluateRelative(edge.T_from_to, T_world_from, T_world_to);
    using Row = Eigen::Matrix<double, 1, TypeParam::kDof>;
    const auto chi2 = [&](const TypeParam& from, const TypeParam& to) {
      return Vector<1>(FactorChi2<TypeParam>(edge, from, to));
    };
    const double tolerance = 1e-8 * (1 + chi2(T_world_from, T_world_to)[0]);
    Row gradient_from, gradient_to;
    gradient_from = 2 * out.residual.transpose() * edge.information * out.J_residual_from;
    gradient_to = 2 * out.residual.transpose() * edge.information * out.J_residual_to;
    EXPECT_TRUE(JacobianMatches(
        gradient_from, [&](const auto& e) { return chi2(T_world_from.Retract(e), T_world_to); }, tolerance));
    EXPECT_TRUE(JacobianMatches(
        gradient_to, [&](const auto& e) { return chi2(T_world_from, T_world_to.Retract(e)); }, tolerance));
  }
}

}  // namespace
}  // namespace terse
