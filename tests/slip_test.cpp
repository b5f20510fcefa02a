// Odometry that fails: found where loops contradict it, left out, reported, and the map is what it would have been.
#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <stdexcept>
#include <string>
#include <string_view>

#include "shared_data.h"
#include "slow_build.h"
#include "terse/core/batch_solver.h"
#include "terse/core/generate.h"
#include "terse/core/graph_file.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/initial_values.h"
#include "terse/core/outliers.h"
#include "terse/core/replay.h"
#include "terse/core/slips.h"
#include "testing_poses.h"
#include "testing_scene.h"

namespace terse {
namespace {

using Ends = std::pair<std::int64_t, std::int64_t>;

template <class Pose>
struct Drive {
  PoseGraph<Pose> graph;
  std::set<Ends> slips;
};

template <class Pose>
Drive<Pose> MakeDrive(Scene scene, long poses, long slips, double wrong_loop_percent, std::uint64_t seed) {
  GenerateOptions options;
  options.scene = scene;
  options.poses = poses;
  options.seed = seed;
  options.slips = slips;
  options.wrong_loop_percent = wrong_loop_percent;
  Drive<Pose> drive;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose&) { drive.graph.AddPose(id); };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { drive.graph.AddFactor(edge); };
  sink.wrong_loop = sink.edge;
  sink.slip = [&](const RelativePoseFactor<Pose>& edge) { drive.slips.emplace(edge.from.value, edge.to.value); };
  Generate(options, sink);
  return drive;
}

template <class Pose>
BatchResult<Pose> Solve(const PoseGraph<Pose>& graph, RobustKernel kernel) {
  BatchOptions options;
  options.robust.kernel = kernel;
  return SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose), options);
}

// Root mean square.
template <class Pose>
double Distance(const std::vector<Pose>& a, const std::vector<Pose>& b) {
  double sum = 0;
  for (std::size_t k = 0; k < a.size(); ++k) sum += (a[k].Translation() - b[k].Translation()).squaredNorm();
  return std::sqrt(sum / static_cast<double>(a.size()));
}

// Batch, by a replay, and step by step. Where no loop is between, one edge is as good as its neighbour.
template <class Pose>
void ExpectSurvived(Scene scene, long poses, long slips, std::uint64_t seed, double wrong_loop_percent,
                    double tolerance) {
  SCOPED_TRACE(::testing::Message() << Pose::kDim << "D, seed " << seed << ", wrong loops " << wrong_loop_percent);
  const auto clean = MakeDrive<Pose>(scene, poses, 0, 0, seed);
  const auto drive = MakeDrive<Pose>(scene, poses, slips, wrong_loop_percent, seed);
  ASSERT_EQ(drive.slips.size(), static_cast<std::size_t>(slips));
  const auto truth = Solve(clean.graph, RobustKernel::kNone);
  const auto found = Solve(drive.graph, RobustKernel::kGnc);
  EXPECT_LT(Distance(found.T_world_body, truth.T_world_body), tolerance);
  const auto left_out = SlippedOdometry(drive.graph, found.weights);
  EXPECT_EQ(left_out.size(), drive.slips.size());
  for (const FactorId id : left_out) {
    const FactorPoses ends = PosesOf(drive.graph.FindFactor(id)->factor);
    bool is_near = false;
    for (const Ends& slip : drive.slips) is_near = is_near || std::abs(slip.first - ends.first.value) <= 10;
    EXPECT_TRUE(is_near) << ends.first.value;
  }
}

TEST(Slip, SurvivedIn2D) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    ExpectSurvived<SE2>(Scene::kManhattan, 800, 2, seed, 0, 1);
    ExpectSurvived<SE2>(Scene::kManhattan, 800, 2, seed, 20, 1);
  }
}

// Of two that all loops across one cross as well no single one explains what the loops say.
TEST(Slip, SurvivedIn3D) {
  for (const std::uint64_t seed : testing::Seeds(1, 4)) ExpectSurvived<SE3>(Scene::kSphere, 500, 1, seed, 0, 0.5);
}

// Among poses that other loops hold on both sides few loops contradict a slip, and wrong ones lie beside them: each of
// these worlds is 3 to 20 times as far off if only slips that every loop crosses are looked for.
TEST(Slip, SurvivedWhereOtherLoopsHoldThePoses) {
  const std::pair<std::uint64_t, double> worlds[] = {{15, 0.06}, {20, 0.05}, {11, 0.2}};
  for (const auto& [seed, tolerance] : worlds) {
    if (kSlowBuild && seed != 15) continue;
    SCOPED_TRACE(seed);
    const auto scene = testing::MakeScene<SE2>(Scene::kManhattan, 1200, seed);
    const auto clean = SolveBatch(scene.graph).T_world_body;
    const auto contaminated = AddWrongLoops(scene.graph, clean, 20, seed, OutlierKind::kGrouped).graph;
    const auto drive = AddSlips(contaminated, 4, seed);
    const auto found = Solve(drive.graph, RobustKernel::kGnc);
    EXPECT_LT(Distance(found.T_world_body, clean), tolerance);
    EXPECT_EQ(SlippedOdometry(drive.graph, found.weights).size(), 4u);
  }
}

// Nothing is left out where nothing slipped.
TEST(Slip, NoneIsInvented) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    for (const double wrong : {0.0, 50.0}) {
      const auto drive = MakeDrive<SE2>(Scene::kManhattan, 800, 0, wrong, seed);
      const auto found = Solve(drive.graph, RobustKernel::kGnc);
      EXPECT_TRUE(SlippedOdometry(drive.graph, found.weights).empty()) << "seed " << seed << ", wrong " << wrong;
    }
  }
}

// Nor if groups of wrong loops agree with each other that something did: such a group is one place.
TEST(Slip, NoneIsInventedByGroups) {
  TERSE_NEEDS(path, "graphs/2d/manhattan.g2o");
  auto graph = std::get<PoseGraph<SE2>>(ReadGraph(path).graph);
  if (kSlowBuild) graph = testing::FirstPoses(graph, 600);
  const auto truth = Solve(graph, RobustKernel::kNone).T_world_body;
  const auto wrong = AddWrongLoops(graph, truth, 100, 2, OutlierKind::kGrouped).graph;
  const auto found = Solve(wrong, RobustKernel::kGnc);
  EXPECT_LT(Distance(found.T_world_body, truth), 1);
  EXPECT_TRUE(SlippedOdometry(wrong, found.weights).empty());
}

// Two laps round a block whose opposite sides look alike. That a robot jumps to the other side four times explains all
// loops; that it does not jump leaves two in three of them out.
TEST(Slip, ARobotDoesNotJump) {
  constexpr int kLap = 100;
  for (const std::uint64_t seed : testing::Seeds(1, 2)) {
    testing::PoseRandom rng(static_cast<unsigned>(seed));
    PoseGraph<SE2> without, with;  // places that look alike
    const auto measure = [&](int from, int to, const SE2& T_from_to) {
      const SE2 measured = T_from_to.Retract(0.01 * rng.NormalVector<3>());
      return RelativePoseFactor<SE2>{{from}, {to}, measured, 1e4 * Matrix<3, 3>::Identity()};
    };
    const auto add = [&](const RelativePoseFactor<SE2>& edge) {
      with.AddFactor(edge);
      without.AddFactor(edge);
    };
    for (int k = 0; k < 2 * kLap; ++k) {
      with.AddPose({k});
      without.AddPose({k});
      if (k > 0) add(measure(k - 1, k, SE2(1, 0, 2 * M_PI / kLap)));
      if (k % 10 == 0) continue;
      if (k >= kLap) add(measure(k - kLap, k, SE2()));
      if (k >= kLap / 2) with.AddFactor(measure(k - kLap / 2, k, SE2()));
    }
    const auto expected = Solve(without, RobustKernel::kNone), found = Solve(with, RobustKernel::kGnc);
    EXPECT_TRUE(SlippedOdometry(with, found.weights).empty());
    EXPECT_LT(Distance(found.T_world_body, expected.T_world_body), 0.01) << "seed " << seed;
  }
}

// What slipped is named while the robot drives, stays named in a stored state, and goes on from there alike.
TEST(Slip, IsInTheState) {
  const auto drive = MakeDrive<SE2>(Scene::kManhattan, 800, 2, 0, 2);
  IncrementalOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  IncrementalSolver<SE2> solver(options);
  int warnings = 0;
  solver.SetLog([&](LogLevel level, std::string_view text) {
    warnings += level == LogLevel::kWarning && text.find("odometry") != std::string_view::npos;
  });
  Replay(drive.graph, ReplayOptions(), solver);
  EXPECT_GE(warnings, 2);
  const std::string path = ::testing::TempDir() + "slip.state";
  solver.Save(path);
  auto restored = IncrementalSolver<SE2>::Load(path);
  EXPECT_EQ(Distance(restored.Estimates(), solver.Estimates()), 0);
  const auto a = solver.Finish(), b = restored.Finish();
  EXPECT_EQ(a.weights, b.weights);
  EXPECT_EQ(Distance(a.T_world_body, b.T_world_body), 0);
}

TEST(Slip, GeneratorChangesNothingElse) {
  const auto clean = MakeDrive<SE3>(Scene::kSphere, 300, 0, 0, 5), with = MakeDrive<SE3>(Scene::kSphere, 300, 4, 0, 5);
  ASSERT_EQ(with.slips.size(), 4U);
  std::size_t changed = 0, k = 0;
  for (const auto& node : with.graph.Factors()) {
    const auto& a = std::get<RelativePoseFactor<SE3>>(node.factor);
    const auto& b = std::get<RelativePoseFactor<SE3>>(clean.graph.Factors()[k++].factor);
    EXPECT_EQ(a.information, b.information);
    const double moved = a.T_from_to.Local(b.T_from_to).norm();
    if (moved == 0) continue;
    ++changed;
    EXPECT_TRUE(with.slips.count({a.from.value, a.to.value}) > 0);
    EXPECT_GT(moved, 0.17) << "ten degrees at least";
  }
  EXPECT_EQ(changed, 4U);
  EXPECT_EQ(AddSlips(clean.graph, 4, 5).slipped.size(), 4U);
  EXPECT_THROW(AddSlips(clean.graph, -1, 5), std::invalid_argument);
  EXPECT_THROW(AddSlips(clean.graph, 300, 5), std::invalid_argument);
  EXPECT_EQ(AddSlips(clean.graph, 299, 5).slipped.size(), 299U);
}

}  // namespace
}  // namespace terse
