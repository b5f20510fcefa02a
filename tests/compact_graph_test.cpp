// A stored graph through compact pose SLAM in one call.

#include "terse/compact/compact_graph.h"

#include <gtest/gtest.h>

#include "terse/core/pose_graph.h"
#include "testing_compact.h"

namespace terse {
namespace {

using testing::Random;

template <class Pose>
PoseGraph<Pose> WalkScene(std::uint64_t seed, int poses = 60) {
  Random rng(seed);
  testing::RandomGraphOptions options;
  options.poses = poses;
  options.noise = 0.05;
  return testing::MakeRandomGraph<Pose>(rng, options).graph;
}

template <class Pose>
class CompactGraphTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactGraphTest, Groups);

// The one call is what the parts do one after the other.
TYPED_TEST(CompactGraphTest, IsTheRunByHand) {
  using Pose = TypeParam;
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    SCOPED_TRACE(seed);
    const PoseGraph<Pose> graph = WalkScene<Pose>(seed);
    const CompactRun<Pose> run = CompactGraph(graph, Strategy::kFpfl);

    CompactOptions<Pose> options;
    options.strategy = Strategy::kFpfl;
    SampleOptions sample;
    sample.strategy = Strategy::kFpfl;
    sample.innovation_quantile = options.innovation_quantile;
    options.thresholds = SelectThresholds(graph, sample).thresholds;
    GraphReplay<Pose> replay(graph);
    const auto by_hand = testing::RunReplay(replay, options);
    const auto result = by_hand.slam->Finish();
    EXPECT_EQ(run.result.chi2, result.chi2);
    EXPECT_EQ(run.PosesKept(), static_cast<int>(by_hand.slam->Solver().Graph().Poses().size()));
    EXPECT_EQ(run.LinksKept(), by_hand.slam->LinksKept());
    EXPECT_EQ(run.links_offered, replay.LinksOffered());

    ASSERT_EQ(run.decisions.size(), graph.Poses().size());
    EXPECT_EQ(run.step_seconds.size(), graph.Poses().size());
    EXPECT_GE(run.Seconds(), 0);
    int kept = 0, tried = 0, refused = 0;
    for (const Decision& decision : run.decisions) {
      kept += decision.Kept();
      tried += decision.registrations_tried;
      refused += decision.links_refused;
      ASSERT_EQ(decision.update.has_value(), decision.Kept());
      if (!decision.update) continue;
      // Its odometry and its links; the first pose has neither.
      const std::size_t odometry = decision.verdict == PoseVerdict::kFirst ? 0 : 1;
      EXPECT_EQ(decision.update->factor_ids.size(), odometry + static_cast<std::size_t>(decision.links_accepted));
      for (const Candidate& c : decision.candidates) {
        if (!c.factor) continue;
        const auto& ids = decision.update->factor_ids;
        EXPECT_NE(std::find(ids.begin(), ids.end(), *c.factor), ids.end());
      }
    }
    EXPECT_EQ(run.PosesKept(), kept);
    EXPECT_EQ(run.registrations_tried, tried);
    EXPECT_EQ(run.links_refused, refused);
    const double chi2 = Chi2(run.KeptGraph());
    EXPECT_NEAR(chi2, run.result.chi2, 1e-9 * chi2 + 1e-12);
  }
}

TYPED_TEST(CompactGraphTest, TheDefaultIsBounded) {
  const auto graph = WalkScene<TypeParam>(1);
  const auto unsaid = CompactGraph(graph), said = CompactGraph(graph, Strategy::kBounded);
  EXPECT_EQ(unsaid.slam.Options().strategy, Strategy::kBounded);
  EXPECT_EQ(CompactOptions<TypeParam>().strategy, Strategy::kBounded);
  EXPECT_EQ(unsaid.result.chi2, said.result.chi2);
  EXPECT_EQ(unsaid.PosesKept(), said.PosesKept());
  EXPECT_NE(unsaid.result.chi2, CompactGraph(graph, Strategy::kFpfl).result.chi2);
  // The thresholds of a sample, too, are for it.
  SampleOptions sample;
  const auto of_default = SelectThresholds(graph, sample).thresholds;
  sample.strategy = Strategy::kBounded;
  EXPECT_EQ(of_default.min_loop_gain, SelectThresholds(graph, sample).thresholds.min_loop_gain);
  CompactOptions<TypeParam> options;
  SampleThresholds(graph, options);
  EXPECT_EQ(options.thresholds.min_loop_gain, of_default.min_loop_gain);
}

TYPED_TEST(CompactGraphTest, GivenOptionsAreObeyed) {
  const auto graph = WalkScene<TypeParam>(4);
  CompactOptions<TypeParam> options;
  options.strategy = Strategy::kApal;
  const auto all = CompactGraph(graph, options);
  EXPECT_EQ(all.PosesKept(), 60);
  EXPECT_EQ(all.KeptGraph().Factors().size(), graph.Factors().size());
  options.strategy = Strategy::kFpfl;
  options.thresholds.min_loop_gain = options.thresholds.min_pose_gain = 1e9;
  EXPECT_EQ(CompactGraph(graph, options).LinksKept(), 0);
  EXPECT_EQ(CompactGraph(graph, Strategy::kApfl).PosesKept(), 60);
  int steps = 0;
  GraphReplay<TypeParam> replay(graph);
  RunCompact<TypeParam>(CompactPoseSlam<TypeParam>(options), replay,
                        [&](const CompactPoseSlam<TypeParam>& slam, const Decision& decision, double seconds) {
                          EXPECT_EQ(slam.PosesSeen(), ++steps);
                          EXPECT_TRUE(slam.HasSeen(decision.id));
                          EXPECT_GE(seconds, 0);
                        });
  EXPECT_EQ(steps, 60);
  // The one call tells as well, and what it is told ends it.
  steps = 0;
  CompactGraph<TypeParam>(graph, Strategy::kApfl,
                          [&](const CompactPoseSlam<TypeParam>&, const Decision&, double) { ++steps; });
  EXPECT_EQ(steps, 60);
  EXPECT_THROW(CompactGraph<TypeParam>(graph, options,
                                       [&](const CompactPoseSlam<TypeParam>& slam, const Decision&, double) {
                                         if (slam.PosesSeen() == 5) throw std::runtime_error("enough");
                                       }),
               std::runtime_error);
}

TYPED_TEST(CompactGraphTest, SmallAndUnusableGraphs) {
  PoseGraph<TypeParam> graph;
  EXPECT_THROW(CompactGraph(graph), std::invalid_argument);
  graph.AddPose(PoseId{7});
  const auto one = CompactGraph(graph);
  EXPECT_EQ(one.PosesKept(), 1);
  EXPECT_EQ(one.KeptGraph().Poses().size(), 1u);
  EXPECT_THROW(CompactGraph(graph, Strategy::kGiven), std::invalid_argument);
  graph.AddPose(PoseId{8});
  EXPECT_THROW(CompactGraph(graph), std::invalid_argument) << "in pieces";
}

}  // namespace
}  // namespace terse
