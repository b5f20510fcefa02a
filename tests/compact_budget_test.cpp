// Budgets: what was asked for of poses, links, density and error is what a run keeps, whatever the thresholds it starts
// with.

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <limits>
#include <string>

#include "terse/compact/aligned_error.h"
#include "terse/compact/compact_graph.h"
#include "terse/compact/error_growth.h"
#include "terse/compact/explored_area.h"
#include "terse/core/gauge.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

PoseGraph<SE2> City(std::uint64_t seed, int poses = 1500) {
  return testing::MakeScene<SE2>(Scene::kManhattan, poses, seed).graph;
}

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
        if (kSlowBuild && (start == 1 || share == 0.4)) continue;
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
      if (kSlowBuild && share == 0.03) continue;
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
  const PoseGraph<SE2> graph = City(4, kSlowBuild ? 600 : 1500);
  const GraphReplay<SE2> replay(graph);
  CompactOptions<SE2> options = Settings(replay, Strategy::kApfl);
  const CompactRun<SE2> without = RunCompact(CompactPoseSlam<SE2>(options), replay);
  options.budget.keep_poses = 0.1;
  options.budget.keep_links = 0.01;
  const CompactRun<SE2> with = RunCompact(CompactPoseSlam<SE2>(options), replay);
  ASSERT_GT(without.LinksKept(), 0.01 * replay.LinksOffered());  // thresholds that follow would keep fewer
  EXPECT_EQ(with.LinksKept(), without.LinksKept());
  EXPECT_EQ(with.result.chi2, without.result.chi2);
}

TEST(CompactBudgetTest, ContinuesBitByBit) {
  const PoseGraph<SE2> graph = City(5);
  const GraphReplay<SE2> replay(graph);
  CompactBudget shares, density, error;
  shares.keep_poses = 0.1;
  shares.keep_links = 0.05;
  density.poses_per_area = 3;
  density.keep_links = 0.05;
  error.error = 1.3;
  for (const CompactBudget& budget : {shares, density, error}) {
    CompactOptions<SE2> options = Settings(replay, Strategy::kBounded);
    options.budget = budget;
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
    const CompactBudget& loaded = resumed->Options().budget;
    EXPECT_EQ(loaded.keep_poses, budget.keep_poses);
    EXPECT_EQ(loaded.keep_links, budget.keep_links);
    EXPECT_EQ(loaded.poses_per_area, budget.poses_per_area);
    EXPECT_EQ(loaded.error, budget.error);
    EXPECT_EQ(resumed->Solver().Chi2(), running.Solver().Chi2());
  }
}

double CellsOf(const std::vector<CompactInput<SE2>>& inputs, const CompactPoseSlam<SE2>& slam) {
  const double cell = AreaCell(slam.Options().thresholds);
  EnteredCells cells(Vector<3>::Zero(), cell);
  for (const auto& input : inputs) {
    const Vector<2> p = slam.Estimate(input.id).Translation();
    cells.Enter({p.x(), p.y(), 0});
  }
  return static_cast<double>(cells.Count());
}

TEST(CompactBudgetTest, KeepsSoManyPosesPerArea) {
  const PoseGraph<SE2> graph = City(6, 800);
  const GraphReplay<SE2> replay(graph);
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) {
    for (const double start : {0.5, 2.0}) {  // wherever the thresholds start
      std::vector<int> kept;
      for (const double density : {2.0, 4.0}) {
        CompactOptions<SE2> options = Settings(replay, strategy);
        options.thresholds.min_pose_gain *= start;
        options.budget.poses_per_area = density;
        const CompactRun<SE2> run = RunCompact(CompactPoseSlam<SE2>(options), replay);
        const double wanted = density * CellsOf(replay.Inputs(), run.slam);
        std::printf("%s, start %.1f, %.0f per cell: kept %d of %.0f wanted\n", Name(strategy), start, density,
                    run.PosesKept(), wanted);
        kept.push_back(run.PosesKept());
        // What the control takes to move a threshold from one end to the other, and the cells of drift.
        EXPECT_NEAR(run.PosesKept(), wanted, 0.35 * wanted);
      }
      EXPECT_GT(kept[1], 1.5 * kept[0]);
    }
  }
}

TEST(CompactBudgetTest, ACellIsAsWideAsTheGreatestRange) {
  Thresholds<SE3> thresholds;
  thresholds.range << 3, 7, 2, 9;  // the last one is an angle
  EXPECT_EQ(AreaCell(thresholds), 7);
}

// Everything kept: the two maps that are compared are one.
TEST(CompactBudgetTest, WithAllLoopsTheErrorDoesNotGrow) {
  const PoseGraph<SE2> graph = testing::MakeScene<SE2>(Scene::kManhattan, 400, 8).graph;
  const GraphReplay<SE2> replay(graph);
  CompactOptions<SE2> options = Settings(replay, Strategy::kApal);
  CompactPoseSlam<SE2> slam(options);
  ErrorGrowth<SE2> growth;
  int links = 0;
  for (const CompactInput<SE2>& input : replay.Inputs()) {
    slam.AddPose(input);
    if (!input.odometry) continue;
    SeenLoops<SE2> seen{input.id, input.id, {}, {}, {}, {}};
    for (const auto& loop : *input.loops) {
      const PoseId other = loop.from == input.id ? loop.to : loop.from;
      seen.measured.push_back({other, SeenFrom(other, loop)});
      ++links;
    }
    growth.See(seen, true, static_cast<int>(seen.measured.size()), options.thresholds.link_covariance, slam.Solver());
  }
  ASSERT_GT(links, 50);
  const auto is_loop = [&](FactorId id) {
    const FactorPoses ends = PosesOf(slam.Solver().Graph().FindFactor(id)->factor);
    return ends.count == 2 && std::abs(ends.first.value - ends.second.value) != 1;
  };
  EXPECT_NEAR(growth.Growth(slam.Solver(), is_loop).value(), 1, 1e-6);
}

// Against dense matrices: the covariance of the positions, the rigid motions taken out by least squares.
template <class Pose>
double DenseAlignedError(const std::vector<Pose>& T_world_body, const MatrixX& H) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  const int n = static_cast<int>(T_world_body.size());
  MatrixX J = MatrixX::Zero(D * n, B * n), motions = MatrixX::Zero(D * n, B);
  for (int i = 0; i < n; ++i) {
    const Pose& T = T_world_body[static_cast<std::size_t>(i)];
    const auto at_zero = T.Translation();
    for (int k = 0; k < D; ++k) {
      J.template block<D, 1>(D * i, B * i + k) = T * Vector<D>(Vector<D>::Unit(k)) - at_zero;
      motions.template block<D, 1>(D * i, k) = Vector<D>::Unit(k);
    }
    for (int k = D; k < B; ++k) {
      const double h = 1e-6;  // a turn of the world about its origin, by central differences
      typename Pose::Tangent turn = Pose::Tangent::Zero();
      turn[k] = h;
      motions.template block<D, 1>(D * i, k) = (Pose::Exp(turn) * at_zero - Pose::Exp(-turn) * at_zero) / (2 * h);
    }
  }
  const MatrixX Sigma = J * H.inverse() * J.transpose();
  const MatrixX N =
      MatrixX::Identity(D * n, D * n) - motions * (motions.transpose() * motions).inverse() * motions.transpose();
  return (N * Sigma * N).trace();
}

template <class Pose>
void ExpectAlignedErrorAsDense(const PoseGraph<Pose>& graph) {
  constexpr int B = Pose::kDof;
  std::vector<Pose> T_world_body;
  for (const auto& node : graph.Poses()) T_world_body.push_back(*node.T_world_body);
  std::vector<LinearFactor<B>> factors = {Anchor(FindGauge(graph, T_world_body))};
  const auto at = [](int k) { return static_cast<std::size_t>(k); };
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int a = graph.IndexOf(ends.first), b = graph.IndexOf(ends.second);
    factors.push_back(Linearize(node.factor, a, b, T_world_body[at(a)], T_world_body[at(b)]));
  }
  const int n = static_cast<int>(T_world_body.size());
  MatrixX H = MatrixX::Zero(B * n, B * n);
  for (const LinearFactor<B>& f : factors) {
    MatrixX A = MatrixX::Zero(B, B * n);
    A.middleCols(B * f.first, B) = f.A_first;
    if (f.second >= 0) A.middleCols(B * f.second, B) += f.A_second;
    H += A.transpose() * A;
  }
  const double dense = DenseAlignedError(T_world_body, H);
  EXPECT_NEAR(ExpectedAlignedError(graph, T_world_body, factors).value(), dense, 1e-6 * dense);
  factors.erase(factors.begin());  // nothing holds the map any more
  EXPECT_FALSE(ExpectedAlignedError(graph, T_world_body, factors));
}

TEST(CompactBudgetTest, ExpectedErrorIsThatOfTheDenseInverse) {
  ExpectAlignedErrorAsDense(testing::MakeScene<SE2>(Scene::kManhattan, 60, 9).graph);
  ExpectAlignedErrorAsDense(testing::MakeScene<SE3>(Scene::kSphere, 40, 10).graph);
}

// More error allowed, smaller map; as it takes loops to find out, and thresholds stay as they are with few of them.
TEST(CompactBudgetTest, FollowsTheErrorThatIsAllowed) {
  const PoseGraph<SE2> graph = City(11, 900);
  const GraphReplay<SE2> replay(graph);
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) {
    std::vector<int> kept, links;
    for (const double error : {1.05, 3.0}) {
      CompactOptions<SE2> options = Settings(replay, strategy);
      options.budget.error = error;
      const CompactRun<SE2> run = RunCompact(CompactPoseSlam<SE2>(options), replay);
      std::printf("%s, error %.2f: kept %d poses, %d links\n", Name(strategy), error, run.PosesKept(), run.LinksKept());
      kept.push_back(run.PosesKept());
      links.push_back(run.LinksKept());
    }
    EXPECT_GT(kept[0], kept[1]);
    EXPECT_GT(links[0], links[1]);
  }
}

// With a sensor instead of measured loops: what nobody registered counts by its probability.
TEST(CompactBudgetTest, FollowsTheErrorWithASensorToo) {
  const PoseGraph<SE2> graph = City(12, 600);
  std::vector<int> kept;
  for (const double error : {1.2, 4.0}) {
    GraphReplay<SE2> replay(graph);
    CompactOptions<SE2> options = Settings(replay, Strategy::kFpfl);
    options.budget.error = error;
    CompactPoseSlam<SE2> slam(options);
    const Registration<SE2> sensor = replay.AsRegistration();
    for (CompactInput<SE2> input : replay.Inputs()) {
      input.loops.reset();
      slam.AddPose(input, sensor);
    }
    kept.push_back(static_cast<int>(slam.Solver().Graph().Poses().size()));
  }
  std::printf("kept %d and %d\n", kept[0], kept[1]);
  EXPECT_GT(kept[0], kept[1]);
}

TEST(CompactBudgetTest, AContinuedMapKnowsItsArea) {
  const PoseGraph<SE2> graph = City(13, 800);
  const GraphReplay<SE2> replay(graph);
  CompactOptions<SE2> options = Settings(replay, Strategy::kFpfl);
  options.budget.poses_per_area = 3;
  CompactPoseSlam<SE2> running(options);
  for (std::size_t k = 0; k < 400; ++k) running.AddPose(replay.Inputs()[k]);
  CompactPoseSlam<SE2> continued = CompactPoseSlam<SE2>::Restore(running.Export(), options);
  for (std::size_t k = 400; k < 800; ++k) continued.AddPose(replay.Inputs()[k]);
  const double wanted = 3 * CellsOf(replay.Inputs(), continued);
  EXPECT_NEAR(static_cast<double>(continued.Solver().Graph().Poses().size()), wanted, 0.35 * wanted);
}

TEST(CompactBudgetTest, RefusesWhatContradictsItself) {
  const auto refuses = [](const CompactBudget& budget, Strategy strategy, const std::string& word) {
    CompactOptions<SE2> options;
    options.strategy = strategy;
    options.budget = budget;
    try {
      CompactPoseSlam<SE2>{options};
    } catch (const std::invalid_argument& error) {
      return std::string(error.what()).find(word) != std::string::npos;
    }
    return false;
  };
  const std::optional<double> none;
  EXPECT_TRUE(refuses({0.1, none, 2.0, none}, Strategy::kBounded, "contradict"));
  EXPECT_TRUE(refuses({none, none, 2.0, 1.2}, Strategy::kBounded, "contradict"));
  EXPECT_TRUE(refuses({none, 0.1, none, 1.2}, Strategy::kFpfl, "contradict"));
  EXPECT_TRUE(refuses({none, none, 2.0, none}, Strategy::kApal, "keeps all poses"));
  EXPECT_TRUE(refuses({none, none, none, 1.2}, Strategy::kApfl, "keeps all poses"));
  for (const double bad : {0.0, -1.0, HUGE_VAL, std::nan("")}) {
    EXPECT_TRUE(refuses({none, none, bad, none}, Strategy::kFpfl, "per area")) << bad;
    EXPECT_TRUE(refuses({none, none, none, bad}, Strategy::kFpfl, "above 1")) << bad;
  }
  EXPECT_TRUE(refuses({none, none, none, 1.0}, Strategy::kFpfl, "above 1"));
  EXPECT_FALSE(refuses({none, 0.1, 2.0, none}, Strategy::kBounded, ""));
}

TEST(CompactBudgetTest, RefusesWhatIsNoShare) {
  for (const double share : {0.0, -0.1, 1.5, std::numeric_limits<double>::quiet_NaN()}) {
    CompactOptions<SE2> options;
    options.budget.keep_poses = share;
    EXPECT_THROW(CompactPoseSlam<SE2>{options}, std::invalid_argument) << share;
    options.budget = {std::nullopt, share, std::nullopt, std::nullopt};
    EXPECT_THROW(CompactPoseSlam<SE2>{options}, std::invalid_argument) << share;
  }
}

}  // namespace
}  // namespace terse
