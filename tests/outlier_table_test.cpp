// The table of methods against wrong loops: how runs are judged and put together, on cases made by hand, and what a run
// measures on a small graph.

#include "tables/outlier_table.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "tables/outlier_run_log.h"
#include "tables/outlier_table_text.h"
#include "terse/core/error.h"
#include "terse/core/graph_file.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

OutlierRun MakeRun(const std::string& method, LoopCounts loops, double ate) {
  OutlierRun run;
  run.kind = OutlierKind::kRandom;
  run.percent = 50;
  run.method = method;
  run.loops = loops;
  run.ate = ate;
  return run;
}

TEST(Judge, CountsLoopsAndComparesWithTheCleanRun) {
  const OutlierRun clean = MakeRun("batch-gnc", {100, 0, 98, 0}, 2);
  OutlierRun run = MakeRun("batch-gnc", {100, 100, 96, 4}, 2.4);
  Judge(clean, 0, run);
  EXPECT_DOUBLE_EQ(run.precision, 0.96);
  EXPECT_DOUBLE_EQ(run.recall, 0.96);
  EXPECT_DOUBLE_EQ(run.error, 2.4);
  EXPECT_DOUBLE_EQ(*run.ratio, 1.2);
  EXPECT_TRUE(run.success) << "1.2 times is still one";
  run.ate = 2.41;
  Judge(clean, 0, run);
  EXPECT_FALSE(run.success);
  run.ate = 2;
  run.loops.wrong_kept = 6;
  Judge(clean, 0, run);
  EXPECT_FALSE(run.success) << "96 of 102";
  run.loops = {100, 100, 0, 0};
  Judge(clean, 0, run);
  EXPECT_EQ(run.precision, 1) << "believes nothing wrong";
  EXPECT_EQ(run.recall, 0);
}

// Its own error: what is small against that is no failure.
TEST(Judge, AddsTheReferencesError) {
  const OutlierRun clean = MakeRun("batch-gnc", {10, 0, 10, 0}, 0);
  OutlierRun run = MakeRun("batch-gnc", {10, 10, 10, 0}, 3);
  Judge(clean, 4, run);
  EXPECT_DOUBLE_EQ(run.error, 5);
  EXPECT_DOUBLE_EQ(*run.ratio, 1.25);
  EXPECT_FALSE(run.success);
  run.ate = 1;
  Judge(clean, 4, run);
  EXPECT_TRUE(run.success);
  Judge(clean, 0, run);
  EXPECT_FALSE(run.ratio) << "to nothing";
}

TEST(Judge, OfCompactMapsRecallIsThatOfTheCleanRun) {
  const OutlierRun clean = MakeRun("compact", {100, 0, 20, 0}, 1);
  OutlierRun run = MakeRun("compact", {100, 100, 15, 0}, 1);
  Judge(clean, 0, run);
  EXPECT_DOUBLE_EQ(run.recall, 0.75);
  EXPECT_TRUE(run.success);
}

TEST(Judge, FailuresAreNoSuccess) {
  OutlierRun clean = MakeRun("batch-gnc", {10, 0, 10, 0}, 1);
  OutlierRun run = MakeRun("batch-gnc", {10, 10, 10, 0}, 1);
  clean.failure = "no solution";
  Judge(clean, 0, run);
  EXPECT_FALSE(run.success);
  EXPECT_FALSE(run.ratio);
  Judge(clean, 0, clean);
  EXPECT_FALSE(clean.success);
}

TEST(TimesOf, AreMedianAndNearestRank) {
  std::vector<double> seconds;
  for (int k = 200; k >= 1; --k) seconds.push_back(1e-3 * k);
  const StepTimes times = TimesOf(seconds);
  EXPECT_NEAR(times.median_ms, 100.5, 1e-9);
  EXPECT_NEAR(times.p99_ms, 198, 1e-9);
  EXPECT_NEAR(times.worst_ms, 200, 1e-9);
  EXPECT_NEAR(TimesOf({0.002}).p99_ms, 2, 1e-12);
}

std::vector<OutlierRun> ThreeRuns() {
  const OutlierRun clean = MakeRun("batch-gnc", {10, 0, 10, 0}, 1);
  std::vector<OutlierRun> runs = {MakeRun("batch-gnc", {10, 10, 10, 0}, 1.1), MakeRun("batch-gnc", {10, 10, 5, 5}, 7),
                                  MakeRun("batch-gnc", {}, 0)};
  runs[0].steps = StepTimes{1, 2, 3};
  runs[1].steps = StepTimes{3, 4, 9};
  runs[2].failure = "no solution";
  for (OutlierRun& run : runs) {
    run.seconds = 2;
    Judge(clean, 0, run);
  }
  return runs;
}

TEST(Summarise, CountsFailedRunsAsInfinitelyWrong) {
  const OutlierRow row = Summarise(ThreeRuns());
  EXPECT_EQ(row.runs, 3);
  EXPECT_EQ(row.failed, 1);
  EXPECT_EQ(row.successes, 1);
  EXPECT_DOUBLE_EQ(row.precision, 0.75);
  EXPECT_DOUBLE_EQ(row.recall, 0.75);
  EXPECT_DOUBLE_EQ(row.median_ate, 7);
  EXPECT_TRUE(std::isinf(row.worst_ate));
  EXPECT_DOUBLE_EQ(row.median_ratio, 7);
  EXPECT_TRUE(std::isinf(row.worst_ratio));
  EXPECT_DOUBLE_EQ(row.steps->median_ms, 2);
  EXPECT_DOUBLE_EQ(row.steps->p99_ms, 3);
  EXPECT_DOUBLE_EQ(row.steps->worst_ms, 9);
  EXPECT_DOUBLE_EQ(row.seconds, 6);
}

TEST(Summarise, OverGraphsByDimension) {
  OutlierGraph plane, space;
  plane.dimension = 2;
  space.dimension = 3;
  plane.runs = space.runs = ThreeRuns();
  space.runs.pop_back();
  plane.runs.insert(plane.runs.begin(), OutlierRun());  // a clean one does not count
  plane.runs.front().method = "batch-gnc";
  for (OutlierRun& run : space.runs) run.percent = 90;
  OutlierGraph unread;
  unread.failure = "no such file";
  const auto all = SummariseAll({space, plane, unread});
  ASSERT_EQ(all.size(), 2u);
  EXPECT_EQ(all[0].dimension, 2);
  EXPECT_EQ(all[0].runs_to_half, 3);
  EXPECT_EQ(all[0].successes_to_half, 1);
  EXPECT_EQ(all[0].runs_at_90, 0);
  ASSERT_EQ(all[0].ratios.size(), 1u);
  EXPECT_EQ(all[0].ratios[0].percent, 50);
  EXPECT_DOUBLE_EQ(all[0].ratios[0].median, 7);
  EXPECT_EQ(all[1].runs_to_half, 0);
  EXPECT_EQ(all[1].runs_at_90, 2);
  EXPECT_EQ(all[1].successes_at_90, 1);
  EXPECT_NEAR(all[1].ratios[0].median, 4.05, 1e-12);
  EXPECT_DOUBLE_EQ(all[1].ratios[0].worst, 7);
}

OutlierScene<SE2> SmallScene() {
  auto scene = testing::MakeScene<SE2>(Scene::kManhattan, 60, 3);
  return {"walk", 0, std::move(scene.graph), {ReferenceKind::kExact, std::move(scene.truth)}};
}

// Without a kernel every loop is believed, with gnc the true ones alone.
TEST(RunOutlierMethod, BelievesWhatTheKernelLeaves) {
  const OutlierScene<SE2> scene = SmallScene();
  const auto with = scene.With(100, 5);  // as many as true ones
  const int loops = static_cast<int>(LoopFactors(scene.graph).size());
  ASSERT_GT(loops, 20);
  for (const std::string mode : {"batch-", "incremental-"}) {
    SCOPED_TRACE(mode);
    const OutlierMap all = RunOutlierMethod(OutlierMethodOf(mode + "none"), scene, with);
    EXPECT_EQ(all.loops.true_loops, loops);
    EXPECT_EQ(all.loops.wrong_loops, static_cast<int>(with.wrong.size()));
    EXPECT_EQ(all.loops.true_kept, loops);
    EXPECT_EQ(all.loops.wrong_kept, all.loops.wrong_loops);
    const OutlierMap some = RunOutlierMethod(OutlierMethodOf(mode + "gnc"), scene, with);
    EXPECT_EQ(some.loops.wrong_loops, all.loops.wrong_loops);
    EXPECT_EQ(some.loops.wrong_kept, 0);
    EXPECT_GT(some.loops.true_kept, loops * 9 / 10);
    EXPECT_LT(some.ate, 0.1);
    EXPECT_GT(all.ate, 5 * some.ate);
    EXPECT_EQ(some.step_seconds.size(), mode == "batch-" ? 0u : scene.graph.Poses().size());
  }
}

TEST(RunOutlierMethod, CountsTheLinksOfCompactMaps) {
  const OutlierScene<SE2> scene = SmallScene();
  for (const OutlierMethod& method : OutlierMethods()) {
    if (method.mode != OutlierMethod::Mode::kCompact) continue;
    SCOPED_TRACE(method.name);
    const OutlierMap clean = RunOutlierMethod(method, scene, scene.With(0, 1));
    EXPECT_EQ(clean.loops.true_loops, static_cast<int>(LoopFactors(scene.graph).size()));
    EXPECT_EQ(clean.loops.wrong_loops, 0);
    EXPECT_EQ(clean.loops.wrong_kept, 0);
    EXPECT_GT(clean.loops.true_kept, 0);
    EXPECT_LE(clean.loops.true_kept, clean.loops.true_loops);
    const auto with = scene.With(50, 2);
    const OutlierMap map = RunOutlierMethod(method, scene, with);
    EXPECT_EQ(map.loops.true_loops, clean.loops.true_loops);
    EXPECT_EQ(map.loops.wrong_loops, static_cast<int>(with.wrong.size()));
    EXPECT_EQ(map.step_seconds.size(), scene.graph.Poses().size());
  }
}

TEST(RunOutlierMethod, StopsWhereItTakesTooLong) {
  const OutlierScene<SE2> scene = SmallScene();
  for (const char* name : {"batch-gnc", "incremental-gnc", "compact"}) {
    EXPECT_THROW(RunOutlierMethod(OutlierMethodOf(name), scene, scene.With(0, 1), 1e-9), std::runtime_error) << name;
  }
  EXPECT_THROW(OutlierMethodOf("batch"), std::invalid_argument);
}

class GraphFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) / "terse_graph_files";
    std::filesystem::remove_all(folder_);
    std::filesystem::create_directories(folder_ / "b" / "c");
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  void Write(const std::string& name, const std::string& text) const { std::ofstream(folder_ / name) << text; }
  std::filesystem::path folder_;
};

TEST_F(GraphFiles, AreThoseOfKnownEndingsInOrder) {
  EXPECT_THROW(FindGraphFiles(folder_.string()), FileError);
  EXPECT_THROW(FindGraphFiles((folder_ / "nowhere").string()), FileError);
  Write("b/z.g2o", "");
  Write("b/c/a.graph", "");
  Write("b/c/z.toro", "");
  Write("y.txt", "ODOMETRY 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("truth.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
  Write("notes.md", "EDGE2");
  std::vector<std::string> names;
  for (const GraphPath& graph : FindGraphFiles(folder_.string())) names.push_back(graph.name);
  EXPECT_EQ(names, (std::vector<std::string>{"a", "b/c/z.toro", "b/z.g2o", "y"}));
}

// As parking-garage's: other than CalibrateInformation, which leaves it as it differs from edge to edge.
TEST_F(GraphFiles, ImplausibleInformationIsScaled) {
  const auto scene = testing::MakeScene<SE3>(Scene::kSphere, 120);
  for (const double cautious : {1.0, 1000.0}) {
    PoseGraph<SE3> graph;
    for (const auto& pose : scene.graph.Poses()) graph.AddPose(pose.id);
    int k = 0;
    for (const auto& node : scene.graph.Factors()) {
      auto edge = std::get<RelativePoseFactor<SE3>>(node.factor);
      edge.information /= cautious * cautious * (1 + 0.3 * (k++ % 4));
      graph.AddFactor(edge);
    }
    EXPECT_TRUE(CalibrateInformation(graph).scale.IsOne());
    const std::string path = (folder_ / "sphere.g2o").string();
    WriteG2o(graph, path);
    OutlierTableOptions options;
    options.methods = {"batch-none"};
    options.quiet = true;
    Progress progress("", 1, true);
    long done = 0;
    const OutlierGraph out = RunOutlierTable({"sphere", path}, folder_.string(), options, {}, progress, done);
    EXPECT_EQ(out.failure, "");
    EXPECT_EQ(done, 1);
    EXPECT_EQ(out.scale.IsOne(), cautious == 1);
    EXPECT_GT(out.sigma, 0);
    EXPECT_LT(out.sigma, 2) << "metres";
    ASSERT_EQ(out.rows.size(), 1u);
    EXPECT_LT(out.rows[0].median_ate, 1e-4) << "is the optimum itself";
  }
}

// What a method has to beat. With nothing wrong they are the optimum, so that the others' clean run is theirs too.
TEST_F(GraphFiles, ChanceAndOdometryKnowNothing) {
  const auto scene = testing::MakeScene<SE2>(Scene::kManhattan, 400);
  const std::string path = (folder_ / "city.g2o").string();
  WriteG2o(scene.graph, path);
  OutlierTableOptions options;
  options.methods = {"batch-none", "chance", "odometry"};
  options.kinds = {OutlierKind::kRandom};
  options.percents = {30};
  options.seeds = 3;
  options.quiet = true;
  Progress progress("", 1, true);
  long done = 0;
  const OutlierGraph out = RunOutlierTable({"city", path}, folder_.string(), options, {}, progress, done);
  ASSERT_EQ(out.runs.size(), 12u);
  std::vector<double> clean;
  for (const OutlierRun& run : out.runs) {
    EXPECT_EQ(run.failure, "");
    const LoopCounts& loops = run.loops;
    if (!run.kind) {
      EXPECT_EQ(loops.true_kept, loops.true_loops);
      clean.push_back(run.ate);
    } else if (run.method == "odometry") {
      EXPECT_EQ(loops.true_kept + loops.wrong_kept, 0);
    } else if (run.method == "chance") {
      EXPECT_NEAR(run.precision, 0.7, 0.1);
      EXPECT_NEAR(run.recall, 0.7, 0.1);
      EXPECT_FALSE(run.success);
    }
  }
  EXPECT_EQ(clean, std::vector<double>(3, clean.front()));
}

TEST_F(GraphFiles, RunLogGivesBackWhatItWasTold) {
  const std::string path = (folder_ / "runs.jsonl").string();
  OutlierGraph graph;
  graph.is.name = "walk";
  graph.poses = 60;
  graph.loops = 41;
  const std::vector<OutlierRun> runs = ThreeRuns();
  {
    OutlierRunLog log(path);
    OutlierRun other = runs[1];
    other.seed = 7;
    log.Add(graph, runs[0]);
    log.Add(graph, other);
    OutlierRun clean = runs[2];
    clean.kind.reset();
    log.Add(graph, clean);
  }
  std::ofstream(path, std::ios::app) << "{\"torn";
  OutlierRunLog log(path);
  const OutlierRun* known = log.Find(KeyOf(graph, runs[0]));
  ASSERT_NE(known, nullptr);
  OutlierRun again = *known;
  Judge(MakeRun("batch-gnc", {10, 0, 10, 0}, 1), 0, again);
  EXPECT_EQ(OutlierRunJson(again), OutlierRunJson(runs[0]));
  OutlierRun other = runs[0];
  other.seed = 8;
  EXPECT_EQ(log.Find(KeyOf(graph, other)), nullptr) << "another seed";
  OutlierRun clean = runs[2];
  clean.kind.reset();
  ASSERT_NE(log.Find(KeyOf(graph, clean)), nullptr);
  EXPECT_EQ(log.Find(KeyOf(graph, clean))->failure, "no solution");
  graph.poses = 61;
  EXPECT_EQ(log.Find(KeyOf(graph, runs[0])), nullptr) << "another graph";
  log.Add(graph, runs[0]);
  EXPECT_NE(OutlierRunLog(path).Find(KeyOf(graph, runs[0])), nullptr) << "after the torn line";
  Write("bad.jsonl", "{\"graph\": \"walk\"}\n");
  EXPECT_THROW(OutlierRunLog((folder_ / "bad.jsonl").string()), FileError);
}

}  // namespace
}  // namespace terse
