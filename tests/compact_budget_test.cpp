// Budgets: the share of poses and links that was asked for is what a run keeps, whatever the thresholds it starts with.

#include <gtest/gtest.h>

#include <cstdio>
#include <limits>
#include <string>

#include "terse/compact/compact_graph.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

PoseGraph<SE2> City(std::uint64_t seed) { return testing::MakeScene<SE2>(Scene::kManhattan, 1500, seed).graph; }

CompactOptions<SE2> Settings(const GraphReplay<SE2>& replay, Strategy strategy) {
  CompactOptions<SE2> options;
  options.strategy = strategy;
  options.thresholds.range = replay.LinkRange();
  options.thresholds.link_covariance = replay.LinkCovariance();
  options.thresholds.min_loop_gain = 1.5;
  options.thresholds.min_pose_gain = 2.7;
  return options;
}

TEST(CompactBudgetTest, KeepsTheShareOfPoses) {
  const PoseGraph<SE2> graph = City(3);
  const GraphReplay<SE2> replay(graph);
  const double poses = static_cast<double>(graph.Poses().size());
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) {
    for (const double start : {0.5, 1.0, 2.0}) {  // wherever the thresholds start
      for (const double share : {0.25, 0.4}) {
        CompactOptions<SE2> options = Settings(replay, strategy);
        options.thresholds.min_pose_gain *= start;
        options.budget.keep_poses = share;
        const CompactRun<SE2> run = RunCompact(CompactPoseSlam<SE2>(options), replay);
        std::printf("%s, start %.1f, %.0f %%: kept %d\n", Name(strategy), start, 100 * share, run.PosesKept());
        // What the control lets the map be ahead or behind by, and what was left at the start of the run.
        EXPECT_NEAR(run.PosesKept(), share * poses, 100 * share + 0.05 * share * poses);
      }
    }
  }
}

TEST(CompactBudgetTest, KeepsNoMoreThanTheShareOfLinks) {
  const PoseGraph<SE2> graph = City(4);
  const GraphReplay<SE2> replay(graph);
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) {
    CompactOptions<SE2> options = Settings(replay, strategy);
    options.thresholds.min_loop_gain = 0.1;
    const int without = RunCompact(CompactPoseSlam<SE2>(options), replay).LinksKept();
    for (const double share : {0.03, 0.06}) {
      options.budget.keep_links = share;
      const int links = RunCompact(CompactPoseSlam<SE2>(options), replay).LinksKept();
      std::printf("%s, %.0f %%: kept %d of %d links, %d without a budget\n", Name(strategy), 100 * share, links,
                  replay.LinksOffered(), without);
      EXPECT_LT(links, without);
      EXPECT_LE(links, share * replay.LinksOffered() + 100 * share + 10);
      EXPECT_GT(links, 0.4 * share * replay.LinksOffered());
    }
  }
}

TEST(CompactBudgetTest, LeavesTheThresholdsOfOtherStrategies) {
  const PoseGraph<SE2> graph = City(4);
  const GraphReplay<SE2> replay(graph);
  CompactOptions<SE2> options = Settings(replay, Strategy::kApfl);
  const CompactRun<SE2> without = RunCompact(CompactPoseSlam<SE2>(options), replay);
  options.budget = {0.1, 0.01};
  const CompactRun<SE2> with = RunCompact(CompactPoseSlam<SE2>(options), replay);
  ASSERT_GT(without.LinksKept(), 0.01 * replay.LinksOffered());  // thresholds that follow would keep fewer
  EXPECT_EQ(with.LinksKept(), without.LinksKept());
  EXPECT_EQ(with.result.chi2, without.result.chi2);
}

TEST(CompactBudgetTest, ContinuesBitByBit) {
  const PoseGraph<SE2> graph = City(5);
  const GraphReplay<SE2> replay(graph);
  CompactOptions<SE2> options = Settings(replay, Strategy::kBounded);
  options.budget = {0.1, 0.05};
  CompactPoseSlam<SE2> running(options);
  std::optional<CompactPoseSlam<SE2>> resumed;
  for (std::size_t k = 0; k < 600; ++k) {
    if (k == 300) {
      const TestFile file("budget.state");
      running.Save(file.Path());
      resumed.emplace(CompactPoseSlam<SE2>::Load(file.Path()));
    }
    const Decision decision = running.AddPose(replay.Inputs()[k]);
    if (!resumed) continue;
    EXPECT_EQ(resumed->AddPose(replay.Inputs()[k]).verdict, decision.verdict) << k;
  }
  EXPECT_EQ(resumed->Options().budget.keep_poses, options.budget.keep_poses);
  EXPECT_EQ(resumed->Solver().Chi2(), running.Solver().Chi2());
}

TEST(CompactBudgetTest, RefusesWhatIsNoShare) {
  for (const double share : {0.0, -0.1, 1.5, std::numeric_limits<double>::quiet_NaN()}) {
    CompactOptions<SE2> options;
    options.budget.keep_poses = share;
    EXPECT_THROW(CompactPoseSlam<SE2>{options}, std::invalid_argument) << share;
    options.budget = {std::nullopt, share};
    EXPECT_THROW(CompactPoseSlam<SE2>{options}, std::invalid_argument) << share;
  }
}

}  // namespace
}  // namespace terse
