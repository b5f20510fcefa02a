#include "terse/core/start_values.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "terse/core/batch_solver.h"
#include "terse/core/elimination_order.h"
#include "terse/core/error.h"
#include "terse/core/generate.h"
#include "testing_walk.h"

namespace terse {
namespace {

using testing::NoisyWalk;
using testing::WalkOptions;

double Solved(const PoseGraph<SE2>& graph, InitialValues method) {
  return SolveBatch(graph, ComputeInitialValues(graph, method)).chi2;
}

const StartTrial& TrialOf(const StartChoice<SE2>& choice, InitialValues method) {
  return *std::find_if(choice.trials.begin(), choice.trials.end(),
                       [&](const StartTrial& trial) { return trial.method == method; });
}

PoseGraph<SE2> Manhattan(long poses, std::uint64_t seed) {
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = poses;
  options.seed = seed;
  PoseGraph<SE2> graph;
  GenerateSink<SE2> sink;
  sink.pose = [&](PoseId id, const SE2&) { graph.AddPose(id); };
  sink.edge = [&](const RelativePoseFactor<SE2>& edge) { graph.AddFactor(edge); };
  Generate(options, sink);
  return graph;
}

TEST(StartValuesTest, GoodGraphsReachTheOptimumWithoutTryingEveryStart) {
  for (const std::uint64_t seed : {1U, 2U, 3U}) {
    SCOPED_TRACE(seed);
    const auto graph = Manhattan(1000, seed);
    const auto choice = ChooseStart(graph);
    EXPECT_EQ(choice.chosen, InitialValues::kChordal);
    EXPECT_EQ(TrialOf(choice, InitialValues::kCompose).iterations, 0);
    EXPECT_LE(TrialOf(choice, InitialValues::kChordal).iterations, 3);
    const double best = std::min(Solved(graph, InitialValues::kChordal), Solved(graph, InitialValues::kCompose));
    EXPECT_NEAR(Solved(graph, InitialValues::kAuto), best, 1e-6 * best);
  }
}

// Where the starts end in different minima the chosen one is seldom beaten, and never by much.
TEST(StartValuesTest, FarLoopsDoNotEndInTheComposedStartsMinimum) {
  int different = 0, worse = 0;
  for (const double radians : {0.05, 0.1, 0.15}) {
    for (unsigned seed = 1; seed <= 4; ++seed) {
      SCOPED_TRACE(::testing::Message() << radians << " rad, seed " << seed);
      WalkOptions walk;
      walk.seed = seed;
      walk.poses = 700;
      walk.radians_per_step = radians;
      const auto graph = NoisyWalk(walk);
      const double composed = Solved(graph, InitialValues::kCompose), chordal = Solved(graph, InitialValues::kChordal);
      const double chosen = Solved(graph, InitialValues::kAuto), best = std::min(composed, chordal);
      different += std::max(composed, chordal) > 1.01 * best;
      worse += chosen > 1.01 * best;
      EXPECT_LE(chosen, 1.5 * best);
    }
  }
  EXPECT_GE(different, 1) << "the walks are too easy";
  EXPECT_LE(worse, 1);
}

TEST(StartValuesTest, TheScaleOfTheInformationDoesNotMatter) {
  WalkOptions walk;
  walk.seed = 3;
  const auto choice = ChooseStart(NoisyWalk(walk));
  walk.scale = 1e-6;
  const auto scaled = ChooseStart(NoisyWalk(walk));
  EXPECT_EQ(choice.chosen, scaled.chosen);
  for (std::size_t k = 0; k < choice.trials.size(); ++k) {
    EXPECT_EQ(choice.trials[k].iterations, scaled.trials[k].iterations);
    EXPECT_NEAR(choice.trials[k].cost, 1e6 * scaled.trials[k].cost, 1e-6 * choice.trials[k].cost);
  }
}

TEST(StartValuesTest, ASolvedFileGoesOn) {
  auto graph = Manhattan(500, 4);
  const auto optimum = SolveBatch(graph);
  ASSERT_TRUE(optimum.Converged());
  graph.SetPoses(optimum.T_world_body);
  const auto choice = ChooseStart(graph);
  EXPECT_EQ(choice.chosen, InitialValues::kFile);
  EXPECT_NEAR(TrialOf(choice, InitialValues::kFile).cost, optimum.chi2, 1e-8 * optimum.chi2);
}

TEST(StartValuesTest, WhatThereIsNotIsSaid) {
  const auto graph = Manhattan(100, 1);
  const auto choice = ChooseStart(graph);
  EXPECT_NE(TrialOf(choice, InitialValues::kFile).unavailable.find("has no value"), std::string::npos);
  EXPECT_TRUE(TrialOf(choice, InitialValues::kChordal).unavailable.empty());

  const auto composed = graph.WithPoses(ComputeInitialValues(graph, InitialValues::kCompose));
  EXPECT_EQ(TrialOf(ChooseStart(composed), InitialValues::kCompose).same, InitialValues::kFile);

  auto parted = graph;
  parted.AddPose({1000});
  EXPECT_THROW(ChooseStart(parted), std::invalid_argument);
  EXPECT_THROW(ChooseStart(PoseGraph<SE2>()), std::invalid_argument);
  auto far = graph;
  far.AddPose({1000});
  far.AddFactor(RelativePoseFactor<SE2>{PoseId{99}, PoseId{1000}, SE2(1e300, 0, 0), 1e10 * Matrix<3, 3>::Identity()});
  EXPECT_THROW(ComputeInitialValues(far, InitialValues::kChordal), NumericalError);
  EXPECT_TRUE(ComputeInitialValues(PoseGraph<SE2>(), InitialValues::kAuto).empty());
}

TEST(StartValuesTest, OneOrderServesAllFactorisations) {
  const PoseGraph<SE2> graph = Manhattan(1500, 2);
  const StartChoice<SE2> start = ChooseStart(graph);
  ASSERT_EQ(start.order, EliminationOrder(graph));
  BatchOptions in_order;
  in_order.order = start.order;
  const BatchResult<SE2> given = SolveBatch(graph, start.T_world_body, in_order),
                         found = SolveBatch(graph, start.T_world_body, BatchOptions());
  EXPECT_LE(static_cast<double>(given.cholesky.Nonzeros()), 1.05 * static_cast<double>(found.cholesky.Nonzeros()));
  EXPECT_NEAR(given.chi2, found.chi2, 1e-9 * found.chi2);
  // One that fills the factor shows that it is used.
  std::mt19937_64 rng(5);
  std::shuffle(in_order.order.begin(), in_order.order.end(), rng);
  const BatchResult<SE2> filled = SolveBatch(graph, start.T_world_body, in_order);
  EXPECT_GT(filled.cholesky.Nonzeros(), 2 * found.cholesky.Nonzeros());
  EXPECT_NEAR(filled.chi2, found.chi2, 1e-9 * found.chi2);
  in_order.order.front() = in_order.order.back();
  EXPECT_THROW(SolveBatch(graph, start.T_world_body, in_order), std::invalid_argument);
  in_order.order.pop_back();
  StartOptions short_order;
  short_order.order = in_order.order;
  EXPECT_THROW(ComputeInitialValues(graph, InitialValues::kChordal, short_order), std::invalid_argument);
  EXPECT_THROW(ChooseStart(graph, short_order), std::invalid_argument);
  EXPECT_THROW(SolveBatch(graph, start.T_world_body, in_order), std::invalid_argument);
}

TEST(StartValuesTest, ThreadsChangeNothing) {
  const auto graph = Manhattan(800, 5);
  const auto one = ChooseStart(graph), two = ChooseStart(graph, {2, {}, {}, {}});
  ASSERT_EQ(one.T_world_body.size(), two.T_world_body.size());
  for (std::size_t k = 0; k < one.T_world_body.size(); ++k) {
    EXPECT_EQ(one.T_world_body[k].Translation(), two.T_world_body[k].Translation());
  }
}

bool SameBits(const std::vector<SE2>& a, const std::vector<SE2>& b) {
  return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), [](const SE2& x, const SE2& y) {
           return x.Translation() == y.Translation() && x.Theta() == y.Theta();
         });
}

// The start that SolveBatch takes on its own is the one that is compared, or composed where a kernel doubts the loops.
TEST(StartValuesTest, SolveBatchChoosesItsStart) {
  const auto graph = Manhattan(400, 7);
  const auto choice = ChooseStart(graph);
  BatchOptions in_order;
  in_order.order = choice.order;
  const auto solved = SolveBatch(graph), by_hand = SolveBatch(graph, choice.T_world_body, in_order);
  EXPECT_TRUE(solved.Converged());
  EXPECT_TRUE(SameBits(solved.T_world_body, by_hand.T_world_body));
  EXPECT_EQ(solved.iterations, by_hand.iterations);
  EXPECT_EQ(StartFor(graph, {}).chosen, choice.chosen);
  EXPECT_EQ(StartFor(graph, {}).trials.size(), 4u);

  BatchOptions robust;
  robust.robust.kernel = RobustKernel::kDcs;
  const auto composed = ComputeInitialValues(graph, InitialValues::kCompose);
  const auto start = StartFor(graph, robust);
  EXPECT_EQ(start.chosen, InitialValues::kCompose);
  EXPECT_TRUE(start.trials.empty());
  EXPECT_TRUE(SameBits(start.T_world_body, composed));
  EXPECT_TRUE(SameBits(SolveBatch(graph, robust).T_world_body, SolveBatch(graph, composed, robust).T_world_body));

  EXPECT_TRUE(StartFor(PoseGraph<SE2>(), {}).T_world_body.empty());
  EXPECT_THROW(SolveBatch(PoseGraph<SE2>()), std::invalid_argument);
  auto parted = graph;
  parted.AddPose({1000});
  EXPECT_THROW(SolveBatch(parted), std::invalid_argument);
}

// Poses held at their values: the relaxation meets them all, not only the first.
TEST(StartValuesTest, ChordalMeetsEveryFixedPose) {
  auto graph = Manhattan(300, 6);
  const auto optimum = SolveBatch(graph);
  for (const std::int64_t id : {20, 130, 290}) {
    graph.SetPose({id}, optimum.T_world_body[static_cast<std::size_t>(graph.IndexOf({id}))]);
    graph.SetFixed({id}, true);
  }
  const auto values = ComputeInitialValues(graph, InitialValues::kChordal);
  for (const std::int64_t id : {20, 130, 290}) {
    const auto k = static_cast<std::size_t>(graph.IndexOf({id}));
    EXPECT_LT(optimum.T_world_body[k].Local(values[k]).norm(), 1e-3) << id;
  }
}

// Position priors on a straight line leave the turn about it free; the direction of the line they give: across that of
// the values, nearly along it, along it, and against it.
TEST(StartValuesTest, ChordalLiesAlongPositionPriorsOnALine) {
  const Vector<3> along = Vector<3>(1, 2, 3).normalized(), across = along.unitOrthogonal();
  for (const Vector<3>& direction : {across, Vector<3>(along + 1e-9 * across), along, Vector<3>(-along + 1e-9 * across),
                                     Vector<3>(-along + 1e-11 * across), Vector<3>(-along)}) {
    PoseGraph<SE3> graph;
    const SE3 T_step(SO3::Exp(Vector<3>::Zero()), along);
    const auto place = [&](std::int64_t k) {
      return Vector<3>(Vector<3>(5, 0, 2) + static_cast<double>(k) * direction.normalized());
    };
    for (std::int64_t k = 0; k < 20; ++k) {
      graph.AddPose({k});
      if (k > 0) graph.AddFactor(RelativePoseFactor<SE3>{{k - 1}, {k}, T_step, SE3::Jacobian::Identity()});
      if (k % 4 == 0) graph.AddFactor(PositionPriorFactor<SE3>{{k}, place(k), Matrix<3, 3>::Identity()});
    }
    const auto values = ComputeInitialValues(graph, InitialValues::kChordal);
    for (std::size_t k = 0; k < values.size(); ++k) {
      EXPECT_LT((values[k].Translation() - place(static_cast<std::int64_t>(k))).norm(), 1e-9)
          << k << " along " << direction.transpose();
    }
  }
}

}  // namespace
}  // namespace terse
