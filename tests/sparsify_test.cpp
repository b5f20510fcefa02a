// Sparsify as a whole: what is kept, what can be recovered, and whether the errors are as large as it says.

#include "terse/compact/sparsify.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "simulation.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/core/batch_solver.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

using testing::Random;
using testing::Simulation;

template <class Pose>
PoseGraph<Pose> RandomScene(std::uint64_t seed, int poses = 40, bool priors = false) {
  Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.loops_per_pose = 1;
  options.id_stride = 3;
  options.priors = priors;
  return testing::MakeRandomGraph<Pose>(rng, options).graph;
}

SparsifyOptions Budget(double links, double poses = 1) {
  SparsifyOptions options;
  options.links = SparsifyBudget{links};
  options.poses = SparsifyBudget{poses};
  return options;
}

template <class Pose>
double Distance(const std::vector<Pose>& a, const std::vector<Pose>& b) {
  double most = 0;
  for (std::size_t k = 0; k < a.size(); ++k) most = std::max(most, a[k].Local(b[k]).norm());
  return most;
}

template <class Pose>
class SparsifyTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(SparsifyTest, Groups);

TYPED_TEST(SparsifyTest, AllOfItIsTheGraphAtItsOptimum) {
  const auto graph = RandomScene<TypeParam>(1);
  const auto small = Sparsify(graph, Budget(1));
  const auto optimum = SolveBatch(graph);
  EXPECT_EQ(small.graph.Factors().size(), graph.Factors().size());
  EXPECT_LT(Distance(small.T_world_body, optimum.T_world_body), 1e-6);
  EXPECT_NEAR(small.chi2, optimum.chi2, 1e-9 * optimum.chi2);
  EXPECT_DOUBLE_EQ(small.expected_error, small.expected_error_whole);
  EXPECT_NEAR(small.log_det_lost, 0, 1e-9);
  EXPECT_EQ(FindDefect(small.map), "");
}

TYPED_TEST(SparsifyTest, KeepsTheBudgetAndTheIds) {
  const auto graph = RandomScene<TypeParam>(2);
  const auto small = Sparsify(graph, Budget(0.3));
  const auto kept = std::count_if(small.links.begin(), small.links.end(), [](const auto& l) { return l.kept; });
  EXPECT_EQ(kept, std::lround(0.3 * static_cast<double>(small.links.size())));
  for (const ConsideredLink& link : small.links)
    EXPECT_EQ(small.graph.FindFactor(link.id) != nullptr, link.kept) << link.id.value;
  const auto optimum = SolveBatch(small.graph);
  EXPECT_NEAR(small.chi2, optimum.chi2, 1e-8 * optimum.chi2);
  EXPECT_GT(small.expected_error, small.expected_error_whole);
  EXPECT_GT(small.log_det_lost, 0);
  // As the two informations have it.
  const double whole = CholeskyAt(graph, small.T_world_body_whole).LogDeterminant();
  const double left = CholeskyAt(small.graph, small.T_world_body_whole).LogDeterminant();
  EXPECT_NEAR(small.log_det_lost, whole - left, 1e-6 * small.log_det_lost);
}

TYPED_TEST(SparsifyTest, DroppedPosesComeBack) {
  for (const bool priors : {false, true}) {
    const auto graph = RandomScene<TypeParam>(3, 40, priors);
    const auto small = Sparsify(graph, Budget(0.4, 0.5));
    EXPECT_EQ(small.graph.Poses().size() + small.dropped.size(), graph.Poses().size());
    if (!priors) {
      EXPECT_EQ(small.graph.Poses().size(), 20u);
    }
    ASSERT_EQ(FindDefect(small.map), "");
    CompactOptions<TypeParam> options;
    options.thresholds.link_covariance = TypeParam::Jacobian::Identity();
    const auto slam = CompactPoseSlam<TypeParam>::Restore(small.map, options);
    const auto trajectory = slam.Trajectory(Recovery::kV2);
    ASSERT_EQ(trajectory.size(), graph.Poses().size());
    // The optimum stays to first order.
    for (std::size_t k = 0; k < trajectory.size(); ++k)
      EXPECT_LT(small.T_world_body[k].Local(trajectory[k].T_world_body).norm(), 0.01) << k;
  }
}

TYPED_TEST(SparsifyTest, RecentredItHasTheOptimumOfTheWhole) {
  const auto graph = RandomScene<TypeParam>(4);
  SparsifyOptions options = Budget(0.2, 0.6);
  options.recentre = true;
  const auto small = Sparsify(graph, options);
  EXPECT_LT(small.chi2, 1e-12);
  const auto optimum = SolveBatch(small.graph);
  for (std::size_t k = 0; k < small.graph.Poses().size(); ++k) {
    const int v = graph.IndexOf(small.graph.Poses()[k].id);
    EXPECT_LT(optimum.T_world_body[k].Local(small.T_world_body_whole[static_cast<std::size_t>(v)]).norm(), 1e-6);
  }
}

TYPED_TEST(SparsifyTest, BudgetOfErrorHolds) {
  const auto graph = RandomScene<TypeParam>(5, 80);
  SparsifyOptions options;
  options.budget_error = 1.1;
  const auto small = Sparsify(graph, options);
  EXPECT_LE(small.expected_error, 1.1 * small.expected_error_whole * (1 + 1e-9));
  EXPECT_LT(small.graph.Factors().size(), graph.Factors().size());
}

// Two parts, one with a prior, doubled links, and every criterion and kind of fixed edges.
TYPED_TEST(SparsifyTest, TakesWhatUsersBring) {
  PoseGraph<TypeParam> graph;
  for (int part = 0; part < 2; ++part) {
    const auto scene = RandomScene<TypeParam>(6 + static_cast<std::uint64_t>(part), 20);
    for (const auto& node : scene.Poses()) graph.AddPose({node.id.value + 1000 * part}, node.T_world_body);
    for (const auto& node : scene.Factors()) {
      auto edge = std::get<RelativePoseFactor<TypeParam>>(node.factor);
      edge.from.value += 1000 * part;
      edge.to.value += 1000 * part;
      graph.AddFactor(edge);
      if (node.id.value % 5 == 0) graph.AddFactor(edge);
    }
  }
  PosePriorFactor<TypeParam> prior;
  prior.pose = graph.Poses()[20].id;
  prior.T_world_body = *graph.Poses()[20].T_world_body;
  prior.information = TypeParam::Jacobian::Identity() * 1e4;
  graph.AddFactor(prior);
  for (const auto criterion : {SparsifyCriterion::kPosition, SparsifyCriterion::kInformation,
                               SparsifyCriterion::kConnectivity, SparsifyCriterion::kRandom}) {
    for (const auto fixed : {FixedEdges::kOdometry, FixedEdges::kTree, FixedEdges::kNone}) {
      if (kSlowBuild && fixed == FixedEdges::kTree) continue;
      SparsifyOptions options = Budget(0.5, 0.6);
      options.criterion = criterion;
      options.fixed = fixed;
      const auto small = Sparsify(graph, options);
      EXPECT_EQ(ConnectedComponents(small.graph).size(), 2u);
      EXPECT_EQ(small.graph.Poses().size(), 24u);
      EXPECT_EQ(FindDefect(small.map), "");
      EXPECT_EQ(small.map.priors.size(), 1u);
    }
  }
}

TYPED_TEST(SparsifyTest, WrongOptionsAreNamed) {
  const auto graph = RandomScene<TypeParam>(8);
  const auto cause = [&](const SparsifyOptions& options) -> std::string {
    try {
      Sparsify(graph, options);
    } catch (const std::invalid_argument& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_NE(cause(Budget(1.5)).find("links"), std::string::npos);
  EXPECT_NE(cause(Budget(1, -1)).find("poses"), std::string::npos);
  SparsifyOptions both = Budget(0.5);
  both.budget_error = 1.1;
  EXPECT_NE(cause(both).find("exclude"), std::string::npos);
  SparsifyOptions less;
  less.budget_error = 0.9;
  EXPECT_NE(cause(less).find("1 or more"), std::string::npos);
  EXPECT_THROW(Sparsify(PoseGraph<TypeParam>(), Budget(1)), std::invalid_argument);
  SparsifyOptions stopped = Budget(0.5);
  stopped.progress = [](const std::string& task, double) { return task != "links"; };
  EXPECT_THROW(Sparsify(graph, stopped), StoppedError);
}

// The errors of the kept poses in the metric of the information that is left, over many runs: no larger than it says.
TYPED_TEST(SparsifyTest, IsNotOverconfident) {
  constexpr int kRuns = kSlowBuild ? 20 : 200, B = TypeParam::kDof;
  double sum = 0;
  int dof = 0;
  for (std::uint64_t seed = 1; seed <= kRuns; ++seed) {
    const Simulation<TypeParam> run = testing::Simulate<TypeParam>(seed);
    const auto small = Sparsify(run.graph, Budget(0.3, 0.5));
    const auto result = SolveBatch(small.graph);
    const Marginals<TypeParam> marginals(small.graph, result);
    std::vector<PoseId> ids;
    Eigen::VectorXd e(B * static_cast<Eigen::Index>(small.graph.Poses().size() - 1));
    for (std::size_t k = 1; k < small.graph.Poses().size(); ++k) {
      const PoseId id = small.graph.Poses()[k].id;
      const TypeParam& truth = run.truth[static_cast<std::size_t>(run.graph.IndexOf(id))];
      e.segment<B>(B * static_cast<Eigen::Index>(ids.size())) = result.T_world_body[k].Local(truth);
      ids.push_back(id);
    }
    sum += testing::Nees(e, marginals.Joint(ids));
    dof = static_cast<int>(e.size());
  }
  const auto interval = testing::NeesInterval(kRuns, dof);
  EXPECT_LT(sum / kRuns, interval.high) << "degrees of freedom " << dof;
  // Nor is it so cautious that this says nothing.
  EXPECT_GT(sum / kRuns, 0.8 * dof);
}

}  // namespace
}  // namespace terse
