// The default map against wrong loops: its error beside that of its clean run.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <iterator>

#include "shared_data.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/contradicted_loops.h"
#include "terse/compact/judged_solve.h"
#include "terse/core/batch_solver.h"
#include "terse/core/evaluate.h"
#include "terse/core/generate.h"
#include "terse/core/graph_file.h"
#include "terse/core/outliers.h"
#include "terse/core/residual.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/covariance/information_scale.h"
#include "testing.h"
#include "testing_lone_loop.h"

namespace terse {
namespace {

struct Drive {
  PoseGraph<SE2> graph;
  std::vector<SE2> truth;
};

Drive MakeCity(std::uint64_t seed, int poses = 1200) {
  Drive drive;
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = poses;
  options.seed = seed;
  GenerateSink<SE2> sink;
  sink.pose = [&](PoseId id, const SE2& T) {
    drive.truth.push_back(T);
    drive.graph.AddPose(id);
  };
  sink.edge = [&](const RelativePoseFactor<SE2>& edge) { drive.graph.AddFactor(edge); };
  Generate(options, sink);
  return drive;
}

double ErrorOf(const CompactRun<SE2>& run, const std::vector<SE2>& truth) {
  std::vector<SE3> estimate, reference;
  for (const auto& pose : run.slam.Trajectory()) estimate.push_back(InSpace(pose.T_world_body));
  for (const SE2& T : truth) reference.push_back(InSpace(T));
  return AbsoluteError(estimate, reference);
}

double ErrorOf(const PoseGraph<SE2>& graph, const std::vector<SE2>& truth) {
  return ErrorOf(CompactGraph(graph), truth);
}

// `percent` of the true loops.
double ErrorWith(const Drive& drive, double percent, OutlierKind kind, std::uint64_t seed) {
  return ErrorOf(AddWrongLoops(drive.graph, drive.truth, percent, seed, kind).graph, drive.truth);
}

// One wrong loop in ten, and three.
TEST(CompactWrongLoops, TheMapOfACityStays) {
  for (const std::uint64_t seed : testing::Seeds(501, 502)) {
    const Drive large = MakeCity(seed), small = MakeCity(seed, 800);
    for (const OutlierKind kind :
         {OutlierKind::kRandom, OutlierKind::kGrouped, OutlierKind::kAliased, OutlierKind::kLocal}) {
      // Those that agree with each other take ten times as long.
      const bool agree = kind == OutlierKind::kGrouped || kind == OutlierKind::kAliased;
      const Drive& drive = agree ? small : large;
      const double clean = ErrorOf(drive.graph, drive.truth);
      const double few = ErrorWith(drive, 100.0 / 9, kind, seed), many = ErrorWith(drive, 300.0 / 7, kind, seed);
      std::printf("seed %ld, kind %d: clean %.3f m, with 10 %% wrong %.3f m, 30 %% %.3f m\n", static_cast<long>(seed),
                  static_cast<int>(kind), clean, few, many);
      EXPECT_LT(few, 1.1 * clean);
      EXPECT_LT(many, 1.2 * clean);
    }
  }
}

// Covariances 50 times too cautious: one wrong loop in ten took the map 8 to 12 m off. With seed 3 the first loops of
// all are wrong: they come in, leave when others show how well loops agree, and full steps lead nowhere then.
TEST(CompactWrongLoops, IntelWithCautiousCovariances) {
  TERSE_NEEDS(path, "graphs/2d/intel.g2o");
  Drive drive;
  drive.graph = ReadPoseGraph<SE2>(path);
  drive.truth = SolveBatch(drive.graph).T_world_body;
  EXPECT_LT(ErrorWith(drive, 100.0 / 9, OutlierKind::kRandom, 1), 0.1);
  EXPECT_LT(ErrorWith(drive, 100.0 / 9, OutlierKind::kRandom, 2), 0.1);
  EXPECT_LT(ErrorWith(drive, 100.0 / 9, OutlierKind::kRandom, 3), 2.5);
}

// Every other loop wrong. One wrong loop that came first stayed where the second look let the first map be.
TEST(CompactWrongLoops, IntelWithEveryOtherOneWrong) {
  TERSE_NEEDS(path, "graphs/2d/intel.g2o");
  Drive drive;
  drive.graph = ReadPoseGraph<SE2>(path);
  drive.truth = SolveBatch(drive.graph).T_world_body;
  const double clean = ErrorOf(drive.graph, drive.truth);
  for (const std::uint64_t seed : testing::Seeds(401, 404)) {
    EXPECT_LT(ErrorWith(drive, 100, OutlierKind::kRandom, seed), 1.1 * clean) << seed;
  }
}

// Odometry and the loops that others bear out leave some poses far off, and true loops there had 500 times the chi2
// that they have at the optimum: some of 2099 were given up, with two of which the map is 0.6 m from it, and 1.6 m
// without.
TEST(CompactWrongLoops, TrueLoopsThatNothingHoldsAreNotGivenUp) {
  TERSE_NEEDS(path, "graphs/2d/manhattanOlson3500_isam.txt");
  const PoseGraph<SE2> graph = ReadPoseGraph<SE2>(path);
  const std::vector<SE2> truth = SolveBatch(graph).T_world_body;
  BatchOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  for (const std::uint64_t seed : {1, 2}) {
    auto with = AddWrongLoops(graph, truth, 100.0 / 9, seed, OutlierKind::kRandom);
    std::sort(with.wrong.begin(), with.wrong.end());
    EXPECT_EQ(ContradictedLoops(with.graph, {}, options), with.wrong) << seed;
  }
}

// A real export under the unit matrix, few loops. The information as calibrated is too certain of nine true ones, which
// cost more than they are worth by the kernel: without them the map is 10 m off.
TEST(CompactWrongLoops, TrueLoopsInTheTailAreNotGivenUp) {
  TERSE_NEEDS(path, "graphs/real/turtlezhong_kitti_02.g2o");
  const PoseGraph<SE3> graph = ReadPoseGraph<SE3>(path);
  const auto with = AddWrongLoops(graph, SolveBatch(graph).T_world_body, 30, 6002, OutlierKind::kRandom);
  ASSERT_EQ(with.wrong.size(), 41u);
  const auto run = CompactGraph(with.graph);
  const std::vector<FactorId>& out = run.loops_left_out;
  std::vector<FactorId> wrong = with.wrong, given_up;
  std::sort(wrong.begin(), wrong.end());
  std::set_difference(out.begin(), out.end(), wrong.begin(), wrong.end(), std::back_inserter(given_up));
  EXPECT_TRUE(given_up.empty()) << given_up.size() << " true ones";
  EXPECT_GE(out.size(), wrong.size() - 1);
}

// A group of wrong ones is explained by bending true ones within their deviations: fewer loops, but more groups, cost
// less without it. The map was 1.7 m off.
TEST(CompactWrongLoops, AGroupMayHideAmongItsNeighbours) {
  TERSE_NEEDS(path, "graphs/igg_spo/FR079.g2o");
  const PoseGraph<SE2> graph = ReadPoseGraph<SE2>(path);
  auto with = AddWrongLoops(graph, SolveBatch(graph).T_world_body, 43, 31001, OutlierKind::kGrouped);
  std::sort(with.wrong.begin(), with.wrong.end());
  const auto run = CompactGraph(with.graph);
  EXPECT_TRUE(
      std::includes(run.loops_left_out.begin(), run.loops_left_out.end(), with.wrong.begin(), with.wrong.end()));
  EXPECT_LE(run.loops_left_out.size(), with.wrong.size() + 1);
}

// Six wrong loops from one place to one other are more than two true ones that they rule out, but one place: the map
// was 6.8 m off with them.
TEST(CompactWrongLoops, AGroupIsOnePlaceHoweverManyItsLoops) {
  TERSE_NEEDS(path, "graphs/igg_spo/MIT-P.g2o");
  const PoseGraph<SE2> graph = ReadPoseGraph<SE2>(path);
  auto with = AddWrongLoops(graph, SolveBatch(graph).T_world_body, 43, 20262, OutlierKind::kGrouped);
  ASSERT_EQ(with.wrong.size(), 9u);
  std::sort(with.wrong.begin(), with.wrong.end());
  EXPECT_EQ(CompactGraph(with.graph).loops_left_out, with.wrong);
}

// Groups of wrong loops that a wide kernel explains are so many loops more, but cost as much as they count (CSAIL's map
// was 0.9 m off, MIT's 14).
TEST(CompactWrongLoops, AGroupGoesThatOthersPayFor) {
  TERSE_NEEDS(floor, "graphs/igg_spo/CSAIL.g2o");
  TERSE_NEEDS(corridors, "graphs/igg_spo/MIT.g2o");
  for (const auto& [path, seed] : {std::pair(floor, 52001u), std::pair(corridors, 52101u)}) {
    const PoseGraph<SE2> graph = ReadPoseGraph<SE2>(path);
    auto with = AddWrongLoops(graph, SolveBatch(graph).T_world_body, 43, seed, OutlierKind::kGrouped);
    std::sort(with.wrong.begin(), with.wrong.end());
    const std::vector<FactorId> out = CompactGraph(with.graph).loops_left_out;
    EXPECT_TRUE(std::includes(out.begin(), out.end(), with.wrong.begin(), with.wrong.end())) << path;
    EXPECT_LE(out.size(), with.wrong.size() + 1) << path;
  }
  // Two groups make each other look better (12.9 m).
  TERSE_NEEDS(city, "graphs/2d/input_M3500_g2o.g2o");
  const PoseGraph<SE2> graph = ReadPoseGraph<SE2>(city);
  auto with = AddWrongLoops(graph, SolveBatch(graph).T_world_body, 100, 52001, OutlierKind::kGrouped);
  std::sort(with.wrong.begin(), with.wrong.end());
  BatchOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  const std::vector<FactorId> out = ContradictedLoops(with.graph, {}, options);
  EXPECT_TRUE(std::includes(out.begin(), out.end(), with.wrong.begin(), with.wrong.end()));
  EXPECT_LE(out.size(), with.wrong.size() + 1);
}

// A group of wrong loops that bends the map by 9 m and that its cautious information hardly contradicts, and a lost map
// that leaves no more loops unexplained than the true one (331 m).
TEST(CompactWrongLoops, NotTheNumberOfExplainedLoopsAloneDecides) {
  TERSE_NEEDS(city, "graphs/2d/input_M3500_g2o.g2o");
  TERSE_NEEDS(hospital, "graphs/mac/ais2klinik.g2o");
  Drive drive;
  drive.graph = ReadPoseGraph<SE2>(city);
  drive.truth = SolveBatch(drive.graph).T_world_body;
  EXPECT_LT(ErrorWith(drive, 300.0 / 7, OutlierKind::kGrouped, 1001), 1.2 * ErrorOf(drive.graph, drive.truth));
  drive.graph = ReadPoseGraph<SE2>(hospital);
  drive.truth = SolveBatch(drive.graph).T_world_body;
  EXPECT_LT(ErrorWith(drive, 100, OutlierKind::kRandom, 1001), 1.5 * ErrorOf(drive.graph, drive.truth));
}

// Half of the loops wrong, in groups that agree with each other, under covariances 50 times too cautious: the first
// come in before it is known how well loops agree, and the map that they bend refuses the true ones. 4.0 and 9.5 m on
// cities 501 and 502 before all loops were judged at the optimum of the whole.
TEST(CompactWrongLoops, HalfOfThemWrongUnderCautiousCovariances) {
  const double root = std::sqrt(50);
  const InformationScale cautious{{root, root}, {root, root}};
  for (const std::uint64_t seed : {501u, 502u}) {
    Drive drive = MakeCity(seed);
    drive.graph = ScaleInformation(drive.graph, cautious);
    const double clean = ErrorOf(drive.graph, drive.truth);
    const auto with = AddWrongLoops(drive.graph, drive.truth, 100, seed, OutlierKind::kGrouped);
    const auto run = CompactGraph(with.graph);
    EXPECT_LT(ErrorOf(run, drive.truth), 3 * clean) << seed << ", clean " << clean;
    // What is left out before the map is made is wrong, nearly all of it, and most that is wrong is.
    const std::vector<FactorId> out = run.loops_left_out;
    std::size_t wrong = 0;
    for (const FactorId id : out) wrong += std::count(with.wrong.begin(), with.wrong.end(), id) > 0;
    EXPECT_GT(static_cast<double>(wrong), 0.98 * static_cast<double>(out.size())) << seed;
    EXPECT_GT(static_cast<double>(wrong), 0.8 * static_cast<double>(with.wrong.size())) << seed;
    EXPECT_EQ(WithoutFactors(with.graph, out).Factors().size(), with.graph.Factors().size() - out.size());
  }
  EXPECT_TRUE(CompactGraph(MakeCity(503).graph).loops_left_out.empty()) << "nothing is in doubt there";
}

// 15 times too cautious, and from edge to edge another: it is left as it is.
PoseGraph<SE2> FarTooCautious(const PoseGraph<SE2>& graph) {
  PoseGraph<SE2> cautious;
  for (const auto& node : graph.Poses()) cautious.AddPose(node.id);
  int k = 0;
  for (const auto& node : graph.Factors()) {
    auto edge = std::get<RelativePoseFactor<SE2>>(node.factor);
    edge.information *= (1 + 0.2 * std::sin(++k)) / (15 * 15);
    cautious.AddFactor(edge);
  }
  return cautious;
}

// The same under such. Judged by it, groups of wrong loops are worth the odometry that they bend, and the first
// judgement of city 602 kept 553 of 810 and gave up 147 true ones; with less caution these contradict the odometry.
TEST(CompactWrongLoops, HalfOfThemWrongUnderFarTooMuchCaution) {
  const Drive drive = MakeCity(602, 600);
  const auto with = AddWrongLoops(FarTooCautious(drive.graph), drive.truth, 100, 602, OutlierKind::kGrouped);
  const auto run = CompactGraph(with.graph);
  std::vector<FactorId> wrong = with.wrong, missed;
  std::sort(wrong.begin(), wrong.end());
  std::set_symmetric_difference(wrong.begin(), wrong.end(), run.loops_left_out.begin(), run.loops_left_out.end(),
                                std::back_inserter(missed));
  EXPECT_LE(static_cast<double>(missed.size()), 0.02 * static_cast<double>(wrong.size()));
}

// gnc of all poses believes them too, unless it is judged again by what residuals show.
TEST(CompactWrongLoops, GncUnderFarTooMuchCautionIsJudgedAgain) {
  const Drive drive = MakeCity(602, 600);
  const auto with = AddWrongLoops(FarTooCautious(drive.graph), drive.truth, 100, 602, OutlierKind::kGrouped);
  BatchOptions options;
  options.robust.kernel = RobustKernel::kGnc;
  struct Mistakes {
    long wrong_believed = 0, true_rejected = 0;
  };
  const std::vector<FactorId> loops = LoopFactors(with.graph);
  const auto count = [&](const BatchResult<SE2>& result) {
    Mistakes out;
    std::size_t k = 0;
    for (const auto& node : with.graph.Factors()) {
      const bool is_believed = result.weights.at(k++) >= 0.5;
      if (!std::binary_search(loops.begin(), loops.end(), node.id)) continue;
      const bool is_wrong = std::count(with.wrong.begin(), with.wrong.end(), node.id) > 0;
      out.wrong_believed += is_wrong && is_believed;
      out.true_rejected += !is_wrong && !is_believed;
    }
    return out;
  };
  const BatchResult<SE2> first = SolveBatch(with.graph, options);
  std::string why;
  const BatchResult<SE2> again = JudgedAgain<SE2>(with.graph, first, options, [&](const std::string& w) { why = w; });
  const Mistakes before = count(first), after = count(again);
  std::printf("wrong believed %ld -> %ld, true rejected %ld -> %ld\n", before.wrong_believed, after.wrong_believed,
              before.true_rejected, after.true_rejected);
  EXPECT_FALSE(why.empty());
  const auto some = static_cast<long>(with.wrong.size() / 50);
  EXPECT_GT(before.wrong_believed, some) << "or there is nothing to mend";
  EXPECT_LE(after.wrong_believed, some);
  EXPECT_LE(after.true_rejected, some);
  double chi2 = 0;
  for (const auto& node : with.graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const auto value = [&](PoseId id) { return again.T_world_body[static_cast<std::size_t>(with.graph.IndexOf(id))]; };
    chi2 += FactorChi2(node.factor, value(ends.first), value(ends.second));
  }
  EXPECT_NEAR(again.chi2, chi2, 1e-9 * chi2);
  // Nothing is in doubt without them.
  why.clear();
  const BatchResult<SE2> clean = SolveBatch(drive.graph, options);
  const BatchResult<SE2> same = JudgedAgain<SE2>(drive.graph, clean, options, [&](const std::string& w) { why = w; });
  EXPECT_EQ(why, "");
  EXPECT_EQ(same.weights, clean.weights);
}

// Half of them random: no other bears them out, and they are judged before there is a map, which is made once.
TEST(CompactWrongLoops, SuspectOnesAreJudgedBeforeThereIsAMap) {
  const Drive drive = MakeCity(504);
  const auto poses = static_cast<long>(drive.graph.Poses().size());
  for (const double percent : {0.0, 100.0}) {
    const auto with = AddWrongLoops(drive.graph, drive.truth, percent, 504, OutlierKind::kRandom);
    long steps = 0;
    const auto run =
        CompactGraph<SE2>(with.graph, Strategy::kBounded, [&](const auto&, const auto&, double) { ++steps; });
    EXPECT_EQ(steps, poses) << percent;
    const auto is_wrong = [&](FactorId id) { return std::count(with.wrong.begin(), with.wrong.end(), id) > 0; };
    const auto& out = run.loops_left_out;
    EXPECT_GE(std::count_if(out.begin(), out.end(), is_wrong), 0.98 * static_cast<double>(with.wrong.size()))
        << percent;
    EXPECT_LE(static_cast<double>(out.size()), 1.02 * static_cast<double>(with.wrong.size())) << percent;
    LoopJury<SE2> jury(with.graph, {}, {RobustKernel::kGnc});
    std::string why;
    jury.on_judging = [&](const std::string& reason) { why = reason; };
    EXPECT_EQ(jury.JudgeAtFirst(), percent > 0);
    EXPECT_EQ(why.empty(), percent == 0) << why;
    EXPECT_FALSE(jury.JudgeBy(run)) << "its map refuses none to speak of";
    EXPECT_EQ(jury.Remaining().Factors().size(), with.graph.Factors().size() - jury.LeftOut().size());
    LoopJury<SE2> without_kernel(with.graph, {}, RobustOptions());
    EXPECT_FALSE(without_kernel.JudgeAtFirst());
  }
}

// The unit matrix for information, and half of the loops wrong: what remains is calibrated again, as it is without
// them, and what is left out are factors of the graph given, whose ids are not their places.
TEST(CompactWrongLoops, InformationIsFoundAgainOfWhatRemains) {
  const Drive drive = MakeCity(505, 500);
  PoseGraph<SE2> stated;
  for (const auto& node : drive.graph.Poses()) stated.AddPose(node.id);
  for (const auto& node : drive.graph.Factors()) {
    auto edge = std::get<RelativePoseFactor<SE2>>(node.factor);
    edge.information.setIdentity();
    stated.AddFactor(edge);
  }
  auto with = AddWrongLoops(stated, drive.truth, 100, 505, OutlierKind::kRandom);
  const FactorId first_loop = LoopFactors(stated).front();  // of the first factors, so that the others move up
  const auto removed = std::get<RelativePoseFactor<SE2>>(stated.FindFactor(first_loop)->factor);
  for (const auto& node : with.graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.first != removed.from || ends.second != removed.to) continue;
    with.graph.RemoveFactor(node.id);
    break;
  }
  const InformationCalibration information = CalibrateInformation(with.graph);
  ASSERT_FALSE(information.scale.IsOne());
  LoopJury<SE2> jury(with.graph, information, {RobustKernel::kGnc});
  ASSERT_TRUE(jury.JudgeAtFirst());
  std::vector<FactorId> wrong = with.wrong, missed;
  std::sort(wrong.begin(), wrong.end());
  std::set_symmetric_difference(wrong.begin(), wrong.end(), jury.LeftOut().begin(), jury.LeftOut().end(),
                                std::back_inserter(missed));
  EXPECT_LE(static_cast<double>(missed.size()), 0.02 * static_cast<double>(wrong.size()));
  const PoseGraph<SE2> left = WithoutFactors(with.graph, jury.LeftOut());
  const InformationScale again = CalibrateInformation(left).scale;
  EXPECT_EQ(jury.Scale().odometry.translation, again.odometry.translation);
  EXPECT_EQ(jury.Scale().loops.rotation, again.loops.rotation);
  EXPECT_NE(jury.Scale().loops.translation, information.scale.loops.translation) << "or wrong loops spoiled nothing";
  const PoseGraph<SE2> expected = ScaleInformation(left, again);
  ASSERT_EQ(jury.Remaining().Factors().size(), expected.Factors().size());
  for (std::size_t k = 0; k < expected.Factors().size(); ++k) {
    const auto& a = std::get<RelativePoseFactor<SE2>>(jury.Remaining().Factors()[k].factor);
    const auto& b = std::get<RelativePoseFactor<SE2>>(expected.Factors()[k].factor);
    EXPECT_EQ(a.information, b.information);
  }
}

// A map refuses none; one that is true is not given up for the wrong one.
TEST(CompactWrongLoops, OneOfAFewThatOdometryJustAllows) {
  for (const std::uint64_t seed : testing::Seeds(1, 3)) {
    auto [graph, wrong] = testing::OutAndBackWithOneWrong(seed);
    CompactOptions<SE2> alone;
    alone.solver.robust = MapRobust({RobustKernel::kGnc}, alone);
    SampleThresholds(graph, alone);
    EXPECT_EQ(CompactGraph(graph, alone).links_refused, 0) << seed;
    EXPECT_EQ(CompactGraph(graph).loops_left_out, std::vector<FactorId>{wrong}) << seed;
    graph.RemoveFactor(wrong);
    EXPECT_TRUE(CompactGraph(graph).loops_left_out.empty()) << seed;
  }
}

}  // namespace
}  // namespace terse
