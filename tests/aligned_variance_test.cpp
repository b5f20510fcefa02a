// The expected position error of a map after alignment, and what a measurement takes from it, against dense algebra.

#include "terse/compact/aligned_variance.h"

#include <gtest/gtest.h>

#include "dense_algebra.h"
#include "simulation.h"
#include "terse/covariance/marginals.h"
#include "testing_bounded.h"

namespace terse::internal {
namespace {

using testing::Laps;
using testing::LapsOptions;

template <class Pose>
class AlignedVarianceTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(AlignedVarianceTest, Groups);

// The rigid motion that fits displacements of positions best is taken out by least squares, numerically: rigid motions
// of the whole map are applied to its poses and their effect on positions measured.
template <class Pose>
double DenseVariance(const PoseGraph<Pose>& graph, const std::vector<Pose>& points) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  const Marginals<Pose> marginals(graph, points);
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  const MatrixX Sigma = marginals.Joint(ids);
  const int n = static_cast<int>(points.size());
  MatrixX positions = MatrixX::Zero(D * n, B * n), motions = MatrixX::Zero(D * n, B);
  for (int k = 0; k < n; ++k) {
    const auto& T = points[static_cast<std::size_t>(k)];
    constexpr double kStep = 1e-6;
    for (int axis = 0; axis < B; ++axis) {
      typename Pose::Tangent d = Pose::Tangent::Zero();
      d[axis] = kStep;
      const Pose plus = T * Pose::Exp(d), minus = T * Pose::Exp(-d);
      positions.block(D * k, B * k + axis, D, 1) = (plus.Translation() - minus.Translation()) / (2 * kStep);
      const Pose moved = Pose::Exp(d) * T, back = Pose::Exp(-d) * T;
      motions.block(D * k, axis, D, 1) = (moved.Translation() - back.Translation()) / (2 * kStep);
    }
  }
  const MatrixX Sigma_pp = positions * Sigma * positions.transpose();
  const MatrixX fit = motions * testing::Inverse(motions.transpose() * motions) * motions.transpose();
  return Sigma_pp.trace() - (fit * Sigma_pp).trace();
}

TYPED_TEST(AlignedVarianceTest, IsThatOfDenseAlgebra) {
  using Pose = TypeParam;
  for (const std::uint64_t seed : ::terse::testing::Seeds(1, 4)) {
    SCOPED_TRACE(seed);
    LapsOptions options;
    options.laps = 2;
    options.per_lap = 16;
    options.noise = 0;
    const Laps<Pose> laps(seed, options);
    IncrementalSolver<Pose> solver;
    const IncrementalMarginals<Pose> marginals(solver);
    AlignedVariance<Pose> variance(solver, marginals);
    for (const auto& input : laps.replay.Inputs()) {
      GraphUpdate<Pose> update;
      update.poses.push_back({input.id, input.T_world_body, false});
      if (input.odometry) update.factors.push_back(*input.odometry);
      for (const auto& loop : *input.loops) update.factors.push_back(loop);
      solver.Update(update);
      if (input.id.value < 3 || input.id.value % 5 != 0) continue;
      const PoseGraph<Pose>& graph = solver.Graph();
      const std::vector<Pose>& points = solver.LinearizationPoints();
      const double before = DenseVariance(graph, points);
      EXPECT_NEAR(variance.Total(), before, 1e-6 * before);
      // A measurement that agrees with the points, so that the graph is linearised there with it.
      const PoseId a{input.id.value / 3}, b = input.id;
      PoseGraph<Pose> with = graph;
      RelativePoseFactor<Pose> link{a, b,
                                    points[static_cast<std::size_t>(graph.IndexOf(a))].Inverse() *
                                        points[static_cast<std::size_t>(graph.IndexOf(b))]};
      const typename Pose::Jacobian Sigma = 1e-3 * Pose::Jacobian::Identity();
      link.information = 1e3 * Pose::Jacobian::Identity();
      with.AddFactor(link);
      const double share = (before - DenseVariance(with, points)) / before;
      EXPECT_NEAR(variance.ShareTold(a, b, Sigma), share, 1e-5 * share + 1e-9);
      EXPECT_GT(share, 0);
      EXPECT_EQ(variance.ShareTold(a, a, Sigma), 0);
    }
  }
}

// Wherever the map lies in the world, and whichever pose holds it.
TYPED_TEST(AlignedVarianceTest, ForgetsTheGauge) {
  using Pose = TypeParam;
  LapsOptions options;
  options.laps = 2;
  options.per_lap = 16;
  options.noise = 0;
  const Laps<Pose> laps(3, options);
  std::vector<double> totals, shares;
  for (const std::int64_t anchored : {0, 9}) {
    IncrementalSolver<Pose> solver;
    const IncrementalMarginals<Pose> marginals(solver);
    GraphUpdate<Pose> update;
    for (const auto& node : laps.scene.graph.Poses()) {
      const Pose truth = laps.scene.truth[static_cast<std::size_t>(node.id.value)];
      update.poses.push_back({node.id, truth, node.id.value == anchored});
    }
    for (const auto& input : laps.replay.Inputs()) {
      if (input.odometry) update.factors.push_back(*input.odometry);
      for (const auto& loop : *input.loops) update.factors.push_back(loop);
    }
    solver.Update(update);
    AlignedVariance<Pose> variance(solver, marginals);
    totals.push_back(variance.Total());
    shares.push_back(variance.ShareTold(PoseId{2}, PoseId{13}, 1e-4 * Pose::Jacobian::Identity()));
  }
  EXPECT_NEAR(totals[0], totals[1], 1e-6 * totals[0]);
  EXPECT_NEAR(shares[0], shares[1], 1e-6 * shares[0]);
  EXPECT_GT(totals[0], 0);
}

// A threshold that cannot be met leaves odometry alone, with re-anchoring as before; one of nothing changes nothing.
TYPED_TEST(AlignedVarianceTest, DecidesWhatABoundedMapKeeps) {
  using Pose = TypeParam;
  Laps<Pose> laps(5);
  const auto links = [&](double share) {
    laps.options.min_variance_drop = share;
    return laps.Run().LinksKept();
  };
  const int all = links(0), some = links(0.01), few = links(0.2), none = links(0.999);
  std::printf("%d links with 0, %d with 0.01, %d with 0.2\n", all, some, few);
  EXPECT_EQ(links(1e-12), all);
  EXPECT_LE(some, all);
  EXPECT_LT(few, some);
  EXPECT_GT(few, 0);
  EXPECT_EQ(none, 0);
  for (const double share : {-0.1, 1.0, std::nan("")}) {
    laps.options.min_variance_drop = share;
    EXPECT_THROW(CompactPoseSlam<Pose>{laps.options}, std::invalid_argument) << share;
  }
}

}  // namespace
}  // namespace terse::internal
