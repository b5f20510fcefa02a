// Wrong minima of the incremental solver, and its way out of them.

#include <gtest/gtest.h>

#include <algorithm>

#include "slow_build.h"
#include "terse/core/incremental_solver.h"
#include "terse/core/initial_values.h"
#include "testing_incremental.h"
#include "testing_walk.h"

namespace terse {
namespace {

using testing::NoisyWalk;
using testing::OnePosePerUpdate;
using testing::WalkOptions;

struct Outcome {
  double chi2 = 0;
  int restarts = 0, reported = 0;
  std::vector<SE2> estimates;
};

Outcome RunWalk(const WalkOptions& walk, bool restart, int threads = 1) {
  IncrementalOptions options;
  options.restart = restart;
  options.threads = threads;
  IncrementalSolver<SE2> solver(options);
  Outcome out;
  for (const auto& update : OnePosePerUpdate(NoisyWalk(walk))) out.reported += solver.Update(update).restarted;
  EXPECT_EQ(out.reported, solver.Restarts());
  out.estimates = solver.Estimates();
  out.chi2 = solver.Finish().chi2;
  out.restarts = solver.Restarts();
  return out;
}

// Which minimum a walk with so much noise ends in is partly chance: another one on the way may lead to a worse one.
TEST(IncrementalRestartTest, LeavesWrongMinima) {
  int lower = 0, higher = 0;
  for (const double radians : {0.15, 0.2}) {
    for (unsigned seed = 1; seed <= (kSlowBuild ? 2U : 24U); ++seed) {
      SCOPED_TRACE(::testing::Message() << radians << " rad, seed " << seed);
      WalkOptions walk;
      walk.seed = seed;
      walk.poses = 700;
      walk.radians_per_step = radians;
      walk.loops = 40;
      const Outcome without = RunWalk(walk, false), with = RunWalk(walk, true);
      EXPECT_EQ(without.restarts, 0);
      EXPECT_LE(with.chi2, 1.3 * without.chi2 + 1e-9);
      lower += with.chi2 < 0.95 * without.chi2;
      higher += with.chi2 > 1.02 * without.chi2;
    }
  }
  EXPECT_GE(lower, kSlowBuild ? 1 : 2);
  EXPECT_LE(higher, lower);
}

// A threshold in units of chi2 would fire with one of the scales.
TEST(IncrementalRestartTest, HealthyMapsAreLeftAloneWhateverTheScale) {
  for (const double scale : {1e-8, 1.0, 1e8}) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      WalkOptions walk;
      walk.seed = seed;
      walk.radians_per_step = 0.005;
      walk.loops = 40;
      walk.scale = scale;
      IncrementalOptions options;
      int tries = 0;
      options.log = [&](LogLevel, std::string_view text) {
        tries += text.find("relaxation") != std::string_view::npos;
      };
      IncrementalSolver<SE2> solver(options);
      for (const auto& update : OnePosePerUpdate(NoisyWalk(walk))) solver.Update(update);
      EXPECT_EQ(tries, 0) << "scale " << scale << ", seed " << seed;
      EXPECT_EQ(solver.Restarts(), 0);
    }
  }
}

TEST(IncrementalRestartTest, RepeatsAndDoesNotDependOnThreads) {
  WalkOptions walk;
  walk.seed = 2;
  walk.radians_per_step = 0.2;
  walk.loops = 40;
  const Outcome one = RunWalk(walk, true), again = RunWalk(walk, true), two = RunWalk(walk, true, 2);
  ASSERT_EQ(one.estimates.size(), two.estimates.size());
  EXPECT_EQ(one.restarts, two.restarts);
  for (std::size_t k = 0; k < one.estimates.size(); ++k) {
    EXPECT_EQ(one.estimates[k].Translation(), again.estimates[k].Translation());
    EXPECT_EQ(one.estimates[k].Translation(), two.estimates[k].Translation());
  }
}

// The values of a wrong minimum: Finish from them stays, Finish on its own looks further.
TEST(IncrementalRestartTest, FinishLooksForALowerMinimum) {
  int found = 0;
  for (unsigned seed = 1; seed <= 12 && found == 0; ++seed) {
    WalkOptions walk;
    walk.seed = seed;
    walk.radians_per_step = 0.15;
    const auto graph = NoisyWalk(walk);
    const auto composed = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose));
    const auto chordal = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kChordal));
    if (!(composed.chi2 > 3 * chordal.chi2)) continue;
    ++found;
    IncrementalSolver<SE2> solver;
    for (const auto& update : OnePosePerUpdate(graph)) solver.Update(update);
    EXPECT_GT(solver.FinishFrom(composed.T_world_body).chi2, 3 * chordal.chi2);
    const int before = solver.Restarts();
    EXPECT_LE(solver.Finish().chi2, 1.01 * chordal.chi2);
    EXPECT_EQ(solver.Restarts(), before + 1);
    EXPECT_LE(solver.Chi2(), 1.01 * chordal.chi2);
  }
  EXPECT_EQ(found, 1) << "no walk whose composed start ends in a wrong minimum";
}

}  // namespace
}  // namespace terse
