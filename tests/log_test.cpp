// The log sink: silent without one, what it is told, and that it cannot disturb the work.

#include "terse/core/log.h"

#include <gtest/gtest.h>

#include <stdexcept>
#include <string>
#include <vector>

#include "terse/core/initial_values.h"
#include "terse/core/log_message.h"
#include "testing_compact.h"
#include "testing_files.h"
#include "testing_incremental.h"

namespace terse {
namespace {

using testing::MakeScene;
using testing::SlippingCircle;

struct Recorder {
  struct Entry {
    LogLevel level;
    std::string text;
  };
  std::vector<Entry> entries;

  LogSink Sink() {
    return [this](LogLevel level, std::string_view text) { entries.push_back({level, std::string(text)}); };
  }
  int Count(const std::string& part, LogLevel most = LogLevel::kDebug) const {
    int count = 0;
    for (const Entry& entry : entries) count += entry.level <= most && entry.text.find(part) != std::string::npos;
    return count;
  }
};

const LogSink kThrowing = [](LogLevel, std::string_view) { throw std::runtime_error("the sink failed"); };

// Counts how often it is put into a message.
struct Part {
  int* printed;
};
std::ostream& operator<<(std::ostream& out, const Part& part) { return out << ++*part.printed; }

TEST(LogTest, BuildsNoMessageWithoutASink) {
  int printed = 0;
  internal::Log(LogSink(), LogLevel::kInfo, "never ", Part{&printed});
  EXPECT_EQ(printed, 0);
  std::string said;
  internal::Log(
      [&](LogLevel level, std::string_view text) { said = std::string(Name(level)) + " " + std::string(text); },
      LogLevel::kWarning, "part ", Part{&printed}, ", ", 0.1234567891);
  EXPECT_EQ(said, "warning part 1, 0.123457");
  internal::Log(kThrowing, LogLevel::kInfo, "dropped");
}

TEST(LogTest, SilentByDefault) {
  const auto scene = MakeScene<SE3>(Scene::kEllipse, 60);
  ::testing::internal::CaptureStdout();
  ::testing::internal::CaptureStderr();
  SolveBatch(scene.graph, ComputeInitialValues(scene.graph, InitialValues::kCompose));
  GraphReplay<SE3> replay(scene.graph);
  testing::RunReplay(replay, testing::OptionsFor(replay, Strategy::kFpfl)).slam->Finish();
  EXPECT_EQ(::testing::internal::GetCapturedStdout() + ::testing::internal::GetCapturedStderr(), "");
}

TEST(LogTest, BatchSaysHowItWent) {
  const auto scene = MakeScene<SE2>(Scene::kManhattan, 100);
  const auto initial = ComputeInitialValues(scene.graph, InitialValues::kCompose);
  Recorder recorder;
  BatchOptions options;
  options.log = recorder.Sink();
  const auto result = SolveBatch(scene.graph, initial, options);
  EXPECT_EQ(recorder.Count("batch: 100 poses", LogLevel::kInfo), 1);
  EXPECT_EQ(recorder.Count("batch: converged after " + std::to_string(result.iterations), LogLevel::kInfo), 1);
  EXPECT_EQ(recorder.Count(": cost "), result.iterations);
  EXPECT_EQ(recorder.Count(": cost ", LogLevel::kInfo), 0);
  options.max_iterations = 1;
  SolveBatch(scene.graph, initial, options);
  EXPECT_EQ(recorder.Count("max_iterations", LogLevel::kWarning), 1);
}

TEST(LogTest, IncrementalSaysEveryStepAndHandsItsLogToFinish) {
  const auto scene = MakeScene<SE2>(Scene::kManhattan, 60);
  Recorder recorder;
  IncrementalOptions options;
  options.log = recorder.Sink();
  IncrementalSolver<SE2> solver(options);
  int open = 0, steps = 0;
  for (const auto& update : testing::OnePosePerUpdate(scene.graph)) {
    open += solver.Update(update).gate_open ? 1 : 0;
    ++steps;
  }
  EXPECT_EQ(recorder.Count("gate "), steps);
  EXPECT_EQ(recorder.Count("gate open"), open);
  EXPECT_EQ(recorder.Count("", LogLevel::kInfo), 0);
  solver.Finish();
  EXPECT_EQ(recorder.Count("batch: converged", LogLevel::kInfo), 1);
  Recorder own;
  BatchOptions finish;
  finish.log = own.Sink();
  solver.Finish(finish);
  EXPECT_EQ(recorder.Count("batch: converged"), 1);
  EXPECT_EQ(own.Count("batch: converged"), 1);
}

TEST(LogTest, IncrementalNamesTheLoopsThatComeIn) {
  const auto scene = MakeScene<SE2>(Scene::kManhattan, 60);
  Recorder recorder;
  IncrementalOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  options.log = recorder.Sink();
  IncrementalSolver<SE2> solver(options);
  auto updates = testing::OnePosePerUpdate(scene.graph);
  for (auto& update : updates) solver.Update(update);
  GraphUpdate<SE2> loop;
  const SE2 T = solver.Estimate(PoseId{5}).Inverse() * solver.Estimate(PoseId{50});
  loop.factors.push_back(RelativePoseFactor<SE2>{PoseId{5}, PoseId{50}, T, Matrix<3, 3>::Identity()});
  solver.Update(loop);
  EXPECT_EQ(recorder.Count("loop 5 - 50 is in"), 1);
}

TEST(LogTest, CompactSaysWhyPosesAndLinksAreKeptOrNot) {
  SlippingCircle circle;
  Recorder recorder;
  circle.options.log = recorder.Sink();
  CompactPoseSlam<SE2> slam(circle.options);
  int refused = 0, accepted = 0, supported = 0;
  for (const auto& input : circle.inputs) {
    const Decision decision = slam.AddPose(input, circle.registration);
    refused += decision.links_refused;
    accepted += decision.links_accepted;
    for (const Candidate& candidate : decision.candidates) supported += candidate.supported;
  }
  ASSERT_GT(refused, 0);
  ASSERT_GT(supported, 0);
  EXPECT_EQ(recorder.Count("refused by the innovation test", LogLevel::kInfo), refused);
  EXPECT_EQ(recorder.Count(" added: gain ", LogLevel::kInfo), accepted);
  EXPECT_EQ(recorder.Count("but other refused links agree"), supported);
  EXPECT_EQ(recorder.Count("all_kept") + recorder.Count("loop_closed") + recorder.Count("first"), 30);
  EXPECT_GT(recorder.Count("step "), 0) << "the solver has the map's log";
}

TEST(LogTest, CompactSaysTheGainOfADroppedPose) {
  const auto scene = MakeScene<SE3>(Scene::kEllipse, 170);
  Recorder recorder;
  GraphReplay<SE3> replay(scene.graph);
  auto options = testing::OptionsFor(replay, Strategy::kFpfl);
  options.log = recorder.Sink();
  const auto run = testing::RunReplay(replay, options);
  int dropped = 0;
  for (const Decision& decision : run.decisions) dropped += !decision.Kept();
  ASSERT_GT(dropped, 0);
  EXPECT_EQ(recorder.Count("dropped, redundant: gain "), dropped);
  EXPECT_EQ(recorder.Count("dropped", LogLevel::kInfo), 0);
}

// The same bytes with a sink, without one, and with one that throws at every message; a loaded run has the sink that
// Load is given.
TEST(LogTest, LeavesStateAndResultAsTheyAre) {
  const auto scene = MakeScene<SE3>(Scene::kEllipse, 60);
  Recorder recorder;
  std::vector<std::string> states;
  for (const LogSink& sink : {LogSink(), recorder.Sink(), kThrowing}) {
    GraphReplay<SE3> replay(scene.graph);
    auto options = testing::OptionsFor(replay, Strategy::kFpfl);
    options.log = sink;
    const auto run = testing::RunReplay(replay, options);
    const TestFile file("log.state", "");
    run.slam->Save(file.Path());
    CompactPoseSlam<SE3> loaded = CompactPoseSlam<SE3>::Load(file.Path(), sink);
    std::string estimates;
    for (const auto& pose : loaded.Trajectory()) {
      const Vector<6> x = pose.T_world_body.Log();
      estimates.append(reinterpret_cast<const char*>(x.data()), sizeof(double) * 6);
    }
    states.push_back(estimates);
    EXPECT_EQ(loaded.Finish().termination, Termination::kConverged);
  }
  EXPECT_EQ(states[0], states[1]);
  EXPECT_EQ(states[0], states[2]);
  EXPECT_EQ(recorder.Count("restored from ", LogLevel::kInfo), 1);
  EXPECT_EQ(recorder.Count("batch: converged"), 1) << "the loaded solver has the log too";
}

}  // namespace
}  // namespace terse
