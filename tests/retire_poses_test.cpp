// Poses that retire, against dense marginalisation of the same map.

#include "terse/compact/retire_poses.h"

#include <gtest/gtest.h>

#include <limits>

#include "testing_bounded.h"

namespace terse {
namespace {

using Eigen::MatrixXd;
using testing::Random;

constexpr double kAnyLoss = std::numeric_limits<double>::max();

// Wherever a pose is, it is known well enough.
template <class Pose>
CompactOptions<Pose> Anywhere(CompactOptions<Pose> options) {
  options.thresholds.range.setConstant(1e3);
  options.thresholds.min_pose_gain = 1e3;
  return options;
}

template <class Pose>
PoseGraph<Pose> GraphOf(const CompactMap<Pose>& map) {
  PoseGraph<Pose> graph;
  for (const auto& pose : map.poses) {
    if (pose.kept) graph.AddPose(pose.id, pose.T_world_body);
  }
  for (const auto& fixed : map.fixed) graph.SetFixed(fixed.pose, true);
  for (const auto& edge : map.edges) graph.AddFactor(edge.measured);
  for (const auto& prior : map.priors) graph.AddFactor(prior.measured);
  return graph;
}

template <class Pose>
testing::DenseSystem SystemOf(const PoseGraph<Pose>& graph) {
  std::vector<Pose> values;
  for (const auto& node : graph.Poses()) values.push_back(*node.T_world_body);
  return testing::MakeDenseSystem(graph, values);
}

// A run over all poses and loops, or by another strategy, at its optimum.
template <class Pose>
CompactPoseSlam<Pose> Run(const PoseGraph<Pose>& graph, const CompactOptions<Pose>& options) {
  CompactPoseSlam<Pose> slam(options);
  const GraphReplay<Pose> replay(graph);
  for (const auto& input : replay.Inputs()) slam.AddPose(input);
  for (int again = 0; again < 8; ++again) slam.Finish();
  return slam;
}

template <class Pose>
CompactOptions<Pose> AllOf(const PoseGraph<Pose>& graph) {
  return Anywhere(testing::OptionsFor(GraphReplay<Pose>(graph), Strategy::kApal));
}

// The covariance that marginalisation leaves to the poses of `after`, and theirs.
template <class Pose>
struct Compared {
  Compared(const CompactMap<Pose>& before, const CompactMap<Pose>& after) {
    constexpr int B = Pose::kDof;
    const PoseGraph<Pose> all = GraphOf(before), rest = GraphOf(after);
    const MatrixXd Sigma = testing::Inverse(SystemOf(all).H);
    const auto system = SystemOf(rest);
    now = testing::Inverse(system.H);
    step = testing::Solve(system.H, system.b).norm();
    exact.resize(now.rows(), now.cols());
    for (const auto& a : rest.Poses()) {
      for (const auto& b : rest.Poses()) {
        exact.block<B, B>(B * rest.IndexOf(a.id), B * rest.IndexOf(b.id)) =
            Sigma.block<B, B>(B * all.IndexOf(a.id), B * all.IndexOf(b.id));
      }
    }
  }
  MatrixXd exact, now;
  double step = 0;  // of Gauss-Newton, at the estimates
};

template <class Pose>
PoseGraph<Pose> RetiringScene(std::uint64_t seed, double loops_per_pose = 0.6, bool priors = false) {
  Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = 24;
  options.loops_per_pose = loops_per_pose;
  options.noise = 0.02;
  options.id_stride = 3;
  options.priors = priors;
  return testing::MakeRandomGraph<Pose>(rng, options).graph;
}

template <class Pose>
class RetirePosesTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(RetirePosesTest, Groups);

TYPED_TEST(RetirePosesTest, LosesNothingBetweenTwoNeighbours) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    const PoseGraph<Pose> graph = RetiringScene<Pose>(seed, 0.2);
    const auto options = AllOf(graph);
    const CompactPoseSlam<Pose> slam = Run(graph, options);
    const CompactMap<Pose> map = slam.Export();
    const Retired<Pose> out = RetirePoses(map, options, {0.0});
    ASSERT_GT(out.poses.size(), 5u);
    for (const RetiredPose& pose : out.poses) {
      EXPECT_EQ(pose.loss, 0);
      EXPECT_LE(pose.neighbours, 2);
      EXPECT_EQ(pose.factors_recovered, pose.neighbours - 1);
    }
    ASSERT_EQ(FindDefect(out.map), "");
    const Compared<Pose> compared(map, out.map);
    EXPECT_LT(testing::RelativeError(compared.now, compared.exact), 1e-8);
    EXPECT_LT(compared.step, 1e-8);
    auto restored = CompactPoseSlam<Pose>::Restore(out.map, options);
    restored.Finish();
    for (const auto& node : restored.Solver().Graph().Poses()) {
      EXPECT_LT(testing::Distance(restored.Estimate(node.id), slam.Estimate(node.id)), 1e-7);
    }
  }
}

TYPED_TEST(RetirePosesTest, IsNeverSurerThanMarginalisationAndMovesNothing) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    SCOPED_TRACE(seed);
    const PoseGraph<Pose> graph = RetiringScene<Pose>(seed, 0.8, seed % 3 == 0);
    const auto options = AllOf(graph);
    const CompactMap<Pose> map = Run(graph, options).Export();
    const Retired<Pose> out = RetirePoses(map, options, {kAnyLoss, 5});
    ASSERT_EQ(FindDefect(out.map), "");
    int most = 0;
    double loss = 0;
    for (const RetiredPose& pose : out.poses) {
      most = std::max(most, pose.neighbours);
      loss += pose.loss;
    }
    if (seed % 3 != 0) {
      EXPECT_GE(most, 3);
    }
    const Compared<Pose> compared(map, out.map);
    EXPECT_LT(compared.step, 1e-7);
    // In the coordinates of the exact covariances.
    const Eigen::VectorXd ratio = testing::Eigenvalues(compared.now, compared.exact);
    EXPECT_GT(ratio.minCoeff(), 1 - 1e-6);
    // What the other factors know of the same makes the loss of the map smaller.
    const double lost = ratio.array().log().sum() / 2;
    EXPECT_LT(lost, loss + 1e-4);
    if (loss > 0) {
      EXPECT_GT(lost, 0);
    }
  }
}

// One pose between three or four, with next to nothing else between these: the map loses what is stated.
TYPED_TEST(RetirePosesTest, StatesWhatIsLost) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  for (const int neighbours : {3, 4}) {
    for (std::uint64_t seed = 1; seed <= 4; ++seed) {
      SCOPED_TRACE(std::to_string(neighbours) + " neighbours, seed " + std::to_string(seed));
      Random rng(seed);
      PoseGraph<Pose> graph;
      std::vector<Pose> truth;
      const Matrix<B, B> weak = 1e-5 * Matrix<B, B>::Identity();
      const auto measure = [&](int i, int j, const Matrix<B, B>& information) {
        const Pose T = truth[static_cast<std::size_t>(i)].Inverse() * truth[static_cast<std::size_t>(j)];
        graph.AddFactor(RelativePoseFactor<Pose>{PoseId{i}, PoseId{j}, T, information});
      };
      // 0, its successors, the pose, and one more from 0 for the run to be at.
      const int pose = neighbours, last = pose + 1;
      for (int k = 0; k <= last; ++k) {
        truth.push_back(testing::RandomMotion<Pose>(rng, 3, 0.5));
        graph.AddPose(PoseId{k}, truth.back());
        if (k > 0 && k != pose) {
          graph.AddFactor(PosePriorFactor<Pose>{PoseId{k}, truth.back(), weak});
          measure(0, k, weak);
        }
      }
      for (int k = 0; k < pose; ++k) measure(k, pose, testing::RandomInformation<B>(rng, 100));
      const auto options = AllOf(graph);
      const CompactMap<Pose> map = Run(graph, options).Export();
      const Retired<Pose> out = RetirePoses(map, options, {kAnyLoss});
      ASSERT_EQ(out.poses.size(), 1u);
      EXPECT_EQ(out.poses[0].id, PoseId{pose});
      EXPECT_EQ(out.poses[0].neighbours, neighbours);
      EXPECT_GT(out.poses[0].loss, 0.01);
      const Compared<Pose> compared(map, out.map);
      const double lost = (testing::LogDeterminant(compared.now) - testing::LogDeterminant(compared.exact)) / 2;
      EXPECT_NEAR(out.poses[0].loss, lost, 1e-3);
    }
  }
}

TYPED_TEST(RetirePosesTest, BringsPosesBackAndContinues) {
  using Pose = TypeParam;
  for (const Strategy strategy : {Strategy::kBounded, Strategy::kFpfl}) {
    for (const double noise : {0.0, 1.0}) {
      SCOPED_TRACE(std::string(Name(strategy)) + (noise > 0 ? ", noise" : ""));
      testing::LapsOptions laps;
      laps.noise = noise;
      testing::Laps<Pose> run(4, laps, strategy);
      const auto inputs = run.replay.Inputs();
      const std::size_t half = 75;
      CompactPoseSlam<Pose> slam(run.options);
      for (std::size_t k = 0; k < half; ++k) slam.AddPose(inputs[k]);
      slam.Finish();
      const CompactMap<Pose> map = slam.Export();
      const Retired<Pose> out = RetirePoses(map, Anywhere(run.options), {10.0, 6});
      ASSERT_GT(out.poses.size(), 3u);
      ASSERT_EQ(FindDefect(out.map), "");
      auto restored = CompactPoseSlam<Pose>::Restore(out.map, run.options);
      restored.Finish();
      const Pose T_truth_world = run.scene.truth[0] * restored.Estimate(PoseId{0}).Inverse();
      // Exact without noise; else, on average over all poses, within what their covariances say.
      const auto check = [&](std::size_t until) {
        double nees = 0;
        for (std::size_t k = 1; k < until; ++k) {
          const PoseId id{static_cast<std::int64_t>(k)};
          const Pose T_truth_body = T_truth_world * restored.Estimate(id, Recovery::kV2);
          if (noise == 0) {
            EXPECT_LT(testing::Distance(run.scene.truth[k], T_truth_body), 1e-6);
          }
          nees += testing::Nees(T_truth_body.Local(run.scene.truth[k]), restored.Covariance(id));
        }
        EXPECT_LT(nees, 2.0 * Pose::kDof * static_cast<double>(until - 1));
        EXPECT_GT(nees, noise > 0 ? 0.05 * static_cast<double>(until) : -1e-9);
      };
      check(half);
      for (std::size_t k = half; k < inputs.size(); ++k) restored.AddPose(inputs[k]);
      restored.Finish();
      EXPECT_EQ(restored.PosesSeen(), static_cast<int>(inputs.size()));
      EXPECT_EQ(FindDefect(restored.Export()), "");
      check(inputs.size());
      // And again.
      const Retired<Pose> more = RetirePoses(restored.Export(), Anywhere(run.options), {10.0, 6});
      EXPECT_EQ(FindDefect(more.map), "");
    }
  }
}

TYPED_TEST(RetirePosesTest, LeavesPosesThatMayNot) {
  using Pose = TypeParam;
  PoseGraph<Pose> graph = RetiringScene<Pose>(5);
  const PoseId fixed = graph.Poses()[7].id, prior = graph.Poses()[11].id;
  graph.SetFixed(fixed, true);
  graph.AddFactor(PosePriorFactor<Pose>{prior, *graph.Poses()[11].T_world_body, Pose::Jacobian::Identity()});
  const auto options = AllOf(graph);
  const CompactMap<Pose> map = Run(graph, options).Export();
  std::map<PoseId, std::set<PoseId>> neighbours;
  for (const auto& edge : map.edges) {
    neighbours[edge.measured.from].insert(edge.measured.to);
    neighbours[edge.measured.to].insert(edge.measured.from);
  }
  const Retired<Pose> out = RetirePoses(map, options, {kAnyLoss, 3});
  EXPECT_FALSE(out.poses.empty());
  for (const RetiredPose& pose : out.poses) {
    EXPECT_LE(pose.neighbours, 3);
    EXPECT_NE(pose.id, map.poses.front().id);
    EXPECT_NE(pose.id, map.poses.back().id) << "the run goes on there";
    EXPECT_NE(pose.id, fixed);
    EXPECT_NE(pose.id, prior);
  }
  // Lonely ones, or known too badly.
  auto strict = options;
  strict.thresholds.range.setConstant(1e-9);
  EXPECT_TRUE(RetirePoses(map, strict, {kAnyLoss}).poses.empty());
  strict = options;
  strict.thresholds.min_pose_gain = 0;
  EXPECT_TRUE(RetirePoses(map, strict, {kAnyLoss}).poses.empty());
  // With weights of their own: those without loops alone.
  for (const RetiredPose& pose : RetirePoses(map, options, {kAnyLoss, 4, true}).poses) {
    EXPECT_LE(neighbours[pose.id].size(), 2u);
  }
  EXPECT_THROW(RetirePoses(map, options, {-1.0}), std::invalid_argument);
  EXPECT_THROW(RetirePoses(map, options, {1.0, 0}), std::invalid_argument);
  auto broken = map;
  broken.edges[0].measured.to = PoseId{12345};
  EXPECT_THROW(RetirePoses(broken, options), std::invalid_argument);
  EXPECT_TRUE(RetirePoses(CompactMap<Pose>(), options).poses.empty());
}

// On a road that is mapped more densely than needed, of poses that all have a neighbour in reach, every pose is known
// well by one that stays, and twice the reach apart is the most that they get.
TYPED_TEST(RetirePosesTest, LeavesNoGroundUncovered) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  for (const std::uint64_t seed : testing::Seeds(1, 4)) {
    SCOPED_TRACE(seed);
    Random rng(seed);
    // Of the second, tens of poses retire in favour of each.
    const int poses = seed == 2 ? 400 : 60;
    const double spacing = 60.0 / poses;
    PoseGraph<Pose> graph;
    Pose T;
    for (int k = 0; k < poses; ++k) {
      typename Pose::Tangent step = Pose::Tangent::Zero();
      step[0] = spacing * testing::Uniform(rng, 0.4, 1.6);
      const Pose T_step = Pose().Retract(step);
      T = T * T_step;
      graph.AddPose(PoseId{k}, T);
      if (k == 0) continue;
      graph.AddFactor(RelativePoseFactor<Pose>{PoseId{k - 1}, PoseId{k}, T_step, 1e6 * Matrix<B, B>::Identity()});
    }
    auto options = testing::OptionsFor(GraphReplay<Pose>(graph), Strategy::kApal);
    options.thresholds.range.setConstant(5);
    options.thresholds.min_pose_gain = 1e3;
    const CompactMap<Pose> map = Run(graph, options).Export();
    const Retired<Pose> out = RetirePoses(map, options, {kAnyLoss});
    std::vector<double> kept;
    for (const auto& pose : out.map.poses) {
      if (pose.kept) kept.push_back(pose.T_world_body.Translation()[0]);
    }
    EXPECT_LT(kept.size(), 25u);
    for (const auto& pose : map.poses) {
      double nearest = 1e9;
      for (const double x : kept) nearest = std::min(nearest, std::abs(x - pose.T_world_body.Translation()[0]));
      EXPECT_LT(nearest, 5.1) << pose.id.value;
    }
    // It ends where it is told to.
    const auto fewer = RetirePoses(map, options, {kAnyLoss, 4, false, {0}, {-2}, poses - 10});
    EXPECT_EQ(fewer.poses.size(), 10u);
    EXPECT_TRUE(RetirePoses(map, options, {kAnyLoss, 4, false, {0}, {-2}, poses}).poses.empty());
  }
}

TYPED_TEST(RetirePosesTest, MoreRetireTheMoreTheyMayLose) {
  using Pose = TypeParam;
  std::size_t all[4] = {0, 0, 0, 0};
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    const PoseGraph<Pose> graph = RetiringScene<Pose>(seed);
    const auto options = AllOf(graph);
    const CompactMap<Pose> map = Run(graph, options).Export();
    int k = 0;
    for (const double most : {0.0, 4.0, 20.0, 1000.0}) {
      const Retired<Pose> out = RetirePoses(map, options, {most});
      for (const RetiredPose& pose : out.poses) EXPECT_LE(pose.loss, most);
      std::size_t kept = 0;
      for (const auto& pose : out.map.poses) kept += pose.kept;
      EXPECT_EQ(kept + out.poses.size(), map.poses.size());
      all[k++] += out.poses.size();
    }
  }
  EXPECT_LT(all[0], all[1]);
  EXPECT_LE(all[1], all[2]);
  EXPECT_LT(all[1], all[3]);
}

}  // namespace
}  // namespace terse
