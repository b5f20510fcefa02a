// A stored graph fed to the incremental solver.

#include "terse/core/replay.h"

#include <gtest/gtest.h>

#include "testing.h"

namespace terse {
namespace {

testing::RandomGraph<SE2> MakeGraph() {
  testing::Random rng(17);
  return testing::MakeRandomGraph<SE2>(rng, {20, 0.5, 0.02});
}

TEST(ReplayTest, BringsEverythingInOrder) {
  const auto random = MakeGraph();
  for (const ArrivalUnit unit : {ArrivalUnit::kPose, ArrivalUnit::kEdge}) {
    const auto steps = ArrivalSteps(random.graph, unit);
    IncrementalSolver<SE2> solver;
    int calls = 0;
    Replay<SE2>(random.graph, {unit}, solver, [&](const ReplayStep& step) {
      EXPECT_EQ(step.index, calls++);
      EXPECT_EQ(step.steps, static_cast<int>(steps.size()));
      EXPECT_EQ(step.report.factor_ids.size(), steps[static_cast<std::size_t>(step.index)].factors.size());
      return true;
    });
    EXPECT_EQ(calls, static_cast<int>(steps.size()));
    EXPECT_EQ(solver.Graph().Poses().size(), random.graph.Poses().size());
    EXPECT_EQ(solver.Graph().Factors().size(), random.graph.Factors().size());
  }
}

TEST(ReplayTest, StopsWhenTold) {
  const auto random = MakeGraph();
  IncrementalSolver<SE2> solver;
  Replay<SE2>(random.graph, {}, solver, [](const ReplayStep& step) { return step.index < 4; });
  EXPECT_EQ(solver.Graph().Poses().size(), 5u);
}

TEST(ReplayTest, StoredValuesAreTakenOrMissed) {
  const auto random = MakeGraph();
  ReplayOptions options;
  options.stored_values = true;
  IncrementalSolver<SE2> solver;
  Replay<SE2>(random.graph, options, solver);
  for (const auto& node : random.graph.Poses()) {
    const auto& taken = solver.Graph().Poses()[static_cast<std::size_t>(solver.Graph().IndexOf(node.id))];
    EXPECT_EQ(node.T_world_body->Local(*taken.T_world_body).norm(), 0);
  }
  PoseGraph<SE2> without;
  for (const auto& node : random.graph.Poses()) without.AddPose(node.id);
  for (const auto& node : random.graph.Factors()) without.AddFactor(node.factor);
  IncrementalSolver<SE2> untouched;
  EXPECT_THROW(Replay<SE2>(without, options, untouched), std::invalid_argument);
  EXPECT_TRUE(untouched.Graph().Poses().empty());
  Replay<SE2>(without, {}, untouched);
  EXPECT_EQ(untouched.Graph().Poses().size(), 20u);
}

}  // namespace
}  // namespace terse
