// How dropped poses come back (S, Eqs. 24-26).

#include <gtest/gtest.h>

#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;
using testing::RunReplay;

template <class Pose>
class RecoveryTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(RecoveryTest, Groups);

constexpr Recovery kAll[] = {Recovery::kV0, Recovery::kV1, Recovery::kV2};

template <class Pose>
int Dropped(const CompactPoseSlam<Pose>& slam) {
  return slam.PosesSeen() - static_cast<int>(slam.Solver().Graph().Poses().size());
}

template <class Pose>
void ExpectExactWithoutNoise(const testing::RandomGraph<Pose>& scene, double min_pose_gain) {
  const auto graph = testing::WithoutNoise(scene);
  auto run = RunReplay(graph, Strategy::kFpfl, 0.1, min_pose_gain);
  ASSERT_GT(Dropped(*run.slam), 2);
  ASSERT_GT(run.slam->LinksKept(), 0);
  for (const Recovery recovery : kAll) {
    const auto trajectory = run.slam->Trajectory(recovery);
    ASSERT_EQ(trajectory.size(), scene.truth.size());
    for (const auto& pose : trajectory) {
      const auto k = static_cast<std::size_t>(graph.IndexOf(pose.id));
      // The solver stops where steps are below its thresholds of 1e-5; exact data leaves rounding only.
      EXPECT_LT(testing::Distance(pose.T_world_body, scene.truth[k]), 1e-8) << "pose " << pose.id.value;
    }
  }
}

TYPED_TEST(RecoveryTest, ExactWithoutNoise) {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    Random rng(seed);
    testing::RandomGraphOptions options;
    options.poses = 50;
    options.loops_per_pose = 0.5;
    options.id_stride = 2;
    ExpectExactWithoutNoise(testing::MakeRandomGraph<TypeParam>(rng, options), 5);
  }
}

template <class Pose>
double MeanError(const std::vector<RecoveredPose<Pose>>& trajectory, const testing::RandomGraph<Pose>& scene) {
  double sum = 0;
  for (const auto& pose : trajectory) {
    const auto& truth = scene.truth[static_cast<std::size_t>(scene.graph.IndexOf(pose.id))];
    sum += pose.kept ? 0 : (pose.T_world_body.Translation() - truth.Translation()).norm();
  }
  return sum;
}

// Errors of the dropped poses: v1 follows the kept poses where v0 stays behind, v2 meets both neighbours.
template <class Pose>
void ExpectOrderOfErrors(Scene kind, long poses, double min_pose_gain) {
  double error[3] = {};
  int dropped = 0;
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const auto scene = testing::MakeScene<Pose>(kind, poses, seed);
    auto run = RunReplay(scene.graph, Strategy::kFpfl, 0.5, min_pose_gain);
    run.slam->Finish();
    dropped += Dropped(*run.slam);
    for (std::size_t r = 0; r < 3; ++r) error[r] += MeanError(run.slam->Trajectory(kAll[r]), scene);
  }
  ASSERT_GT(dropped, 100);
  EXPECT_LT(error[1], error[0]);
  EXPECT_LT(error[2], error[1]);
}

TEST(RecoveryScenes, ErrorsShrinkFromV0ToV2OnTheEllipse) { ExpectOrderOfErrors<SE3>(Scene::kEllipse, 0, 5); }
TEST(RecoveryScenes, ErrorsShrinkFromV0ToV2OnManhattan) { ExpectOrderOfErrors<SE2>(Scene::kManhattan, 300, 4); }

TYPED_TEST(RecoveryTest, KeptPosesAreTheSameInAllAndPosesAreInOrderOfArrival) {
  Random rng(7);
  testing::RandomGraphOptions options;
  options.poses = 60;
  options.loops_per_pose = 0.2;
  options.id_stride = -3;  // ids fall, so that the order of arrival is not that of the graph
  const auto random = testing::MakeRandomGraph<TypeParam>(rng, options);
  GraphReplay<TypeParam> replay(random.graph);
  auto compact = testing::OptionsFor(replay, Strategy::kFpfl);
  compact.thresholds.min_pose_gain = 3;
  const auto run = RunReplay(replay, compact);
  ASSERT_GT(Dropped(*run.slam), 5);
  const auto v0 = run.slam->Trajectory(Recovery::kV0), v1 = run.slam->Trajectory(Recovery::kV1),
             v2 = run.slam->Trajectory();
  ASSERT_EQ(v0.size(), replay.Inputs().size());
  for (std::size_t k = 0; k < v0.size(); ++k) {
    for (const auto* v : {&v0, &v1, &v2}) {
      EXPECT_EQ((*v)[k].id, replay.Inputs()[k].id);
      EXPECT_EQ((*v)[k].kept, run.slam->Solver().Graph().HasPose((*v)[k].id));
      EXPECT_TRUE((*v)[k].T_world_body.Translation().allFinite());
    }
    EXPECT_EQ(testing::Distance(v1[k].T_world_body, run.slam->Estimate(v1[k].id)), 0);
    if (!v0[k].kept) continue;
    EXPECT_EQ(testing::Distance(v0[k].T_world_body, v1[k].T_world_body), 0);
    EXPECT_EQ(testing::Distance(v0[k].T_world_body, v2[k].T_world_body), 0);
  }
}

// Two poses dropped between 0 and 3, and a loop that moves 3: the two lie on the chain that minimises chi2 between
// the ends as they are.
TYPED_TEST(RecoveryTest, V2IsTheMostLikelyChainBetweenItsEnds) {
  using Pose = TypeParam;
  constexpr int B = Pose::kDof;
  Random rng(9);
  std::vector<RelativePoseFactor<Pose>> steps;
  for (int k = 0; k < 3; ++k) {
    steps.push_back(
        {PoseId{k}, PoseId{k + 1}, testing::RandomMotion<Pose>(rng, 1, 0.3), testing::RandomInformation<B>(rng, 1000)});
  }
  CompactOptions<Pose> options;
  options.strategy = Strategy::kFpfl;
  options.thresholds.range.setConstant(10);
  options.thresholds.min_loop_gain = 0.01;
  options.thresholds.min_pose_gain = 1e9;
  options.thresholds.link_covariance = 1e-6 * Pose::Jacobian::Identity();
  CompactPoseSlam<Pose> slam(options);
  // A small misfit, so that first order is enough.
  const double misfit = 1e-4;
  for (int k = 0; k <= 3; ++k) {
    CompactInput<Pose> input;
    input.id = PoseId{k};
    if (k > 0) input.odometry = steps[static_cast<std::size_t>(k - 1)];
    if (k == 3) {
      const Pose exact = steps[0].T_from_to * steps[1].T_from_to * steps[2].T_from_to;
      input.loops = {RelativePoseFactor<Pose>{PoseId{0}, input.id, exact.Retract(Pose::Tangent::Constant(misfit)),
                                              1e8 * Pose::Jacobian::Identity()}};
    }
    slam.AddPose(input);
  }
  ASSERT_EQ(Dropped(slam), 2);
  slam.Finish();
  PoseGraph<Pose> chain;
  for (const auto& pose : slam.Trajectory()) chain.AddPose(pose.id, pose.T_world_body);
  for (const auto& step : steps) chain.AddFactor(step);
  // The gradient of chi2 in the two poses between vanishes, to second order in the misfit.
  std::vector<Pose> values;
  for (const auto& node : chain.Poses()) values.push_back(*node.T_world_body);
  const Eigen::VectorXd b = testing::MakeDenseSystem(chain, values).b;
  EXPECT_LT(b.segment(B, 2 * B).norm(), 1e-2 * b.tail(B).norm());
  EXPECT_GT(b.tail(B).norm(), 0);
}

}  // namespace
}  // namespace terse
