// Steps with a budget of time, on worlds whose closures move the whole map: work that waits must not cost the map.
// Nothing here depends on how fast the machine is.

#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "terse/core/generate.h"
#include "terse/core/replay.h"
#include "testing_incremental.h"

namespace terse {
namespace {

template <class Pose>
PoseGraph<Pose> World(Scene scene, long poses, std::uint64_t seed) {
  GenerateOptions options;
  options.scene = scene;
  options.poses = poses;
  options.seed = seed;
  PoseGraph<Pose> graph;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose&) { graph.AddPose(id); };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { graph.AddFactor(edge); };
  Generate(options, sink);
  return graph;
}

// With a budget that nothing fits into, the least is done in every step; the map comes to the same minimum soon after
// nothing arrives any more.
template <class Pose>
void ExpectSameMap(const PoseGraph<Pose>& graph, double budget_seconds) {
  IncrementalSolver<Pose> whole;
  Replay<Pose>(graph, {}, whole);
  IncrementalOptions options;
  options.budget_seconds = budget_seconds;
  IncrementalSolver<Pose> solver(options);
  int deferred = 0, relinearised = 0;
  Replay<Pose>(graph, {}, solver, [&](const ReplayStep& step) {
    deferred += step.report.deferred_relinearisations > 0;
    relinearised += step.report.variables_relinearised;
    return true;
  });
  EXPECT_GT(deferred, 0);
  EXPECT_GT(relinearised, 0);
  bool waits = true;
  int steps = 0;
  for (; waits && steps < 20000; ++steps) {
    const auto report = solver.Update({});
    waits = report.deferred_fronts > 0 || report.deferred_relinearisations > 0;
  }
  EXPECT_FALSE(waits);
  EXPECT_NEAR(solver.Chi2(), whole.Chi2(), 1e-3 * whole.Chi2());
}

// Where no step comes near the budget the clock decides nothing, however loaded the machine is: here the first fix of
// the map holds its step up for longer than the budget before anything is optimised.
TEST(StepBudget, SmallMapsDoNotLookAtTheClock) {
  const PoseGraph<SE2> graph = World<SE2>(Scene::kManhattan, 100, 3);
  const auto run = [&](double budget_seconds) {
    IncrementalOptions options;
    options.budget_seconds = budget_seconds;
    bool is_late = false;
    options.log = [&](LogLevel, std::string_view text) {
      if (text.find("not determined by the priors yet") == std::string_view::npos) return;
      std::this_thread::sleep_for(std::chrono::duration<double>(1.2 * budget_seconds));
      is_late = true;
    };
    IncrementalSolver<SE2> solver(options);
    int deferred = 0;
    const auto count = [&](const StepReport& report) {
      deferred += report.deferred_relinearisations + report.deferred_fronts;
    };
    Replay<SE2>(graph, {}, solver, [&](const ReplayStep& step) {
      count(step.report);
      return true;
    });
    const PositionPriorFactor<SE2> fix{PoseId{50}, {3, 4}, 1e2 * Matrix<2, 2>::Identity()};
    count(solver.Update(
        {{}, {fix, RelativePoseFactor<SE2>{PoseId{10}, PoseId{90}, SE2(), SE2::Jacobian::Identity()}}, {}}));
    EXPECT_TRUE(is_late);
    std::vector<Vector<3>> estimates;
    for (const SE2& T : solver.Estimates()) {
      estimates.emplace_back(T.Translation().x(), T.Translation().y(), T.Theta());
    }
    return std::pair(deferred, estimates);
  };
  const auto none = run(0), frame = run(0.033);
  EXPECT_GT(run(1e-9).first, 0);
  EXPECT_EQ(frame.first, 0);
  EXPECT_EQ(frame.second, none.second);
}

TEST(StepBudget, ManhattanComesToTheSameMap) {
  for (const std::uint64_t seed : {3U, 4U, 5U}) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    ExpectSameMap(World<SE2>(Scene::kManhattan, 400, seed), 1e-9);
  }
}

TEST(StepBudget, SphereComesToTheSameMap) { ExpectSameMap(World<SE3>(Scene::kSphere, 250, 5), 1e-9); }

}  // namespace
}  // namespace terse
