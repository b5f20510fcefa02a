// Covariances kept step by step over public data sets, beside CHOLMOD's inverse of the same system at sampled steps.
// Builds with sanitizers take the first part of each run.

#include <gtest/gtest.h>

#include <algorithm>
#include <iostream>

#include "covariance_oracle.h"
#include "shared_data.h"
#include "terse/core/graph_file.h"
#include "terse/core/replay.h"

namespace terse {
namespace {

struct Run {
  int steps, interval;
};

// 1e-7 where the system allows it. On parking-garage, whose odometry is good to 1 m and 1 rad per step and 4 m long,
// the condition of H costs that much in any inverse made of it: there ours may not be much worse than CHOLMOD's.
void ExpectEqualCholmod(const std::string& path, const Run& run) {
  const auto graph = std::get<PoseGraph<SE3>>(ReadGraph(path, {}).graph);
  const int share = kSlowBuild ? 20 : 1, steps = run.steps / share, interval = run.interval / share;
  IncrementalSolver<SE3> solver;
  IncrementalMarginals<SE3> marginals(solver);
  testing::InverseErrors worst;
  int samples = 0;
  Replay<SE3>(graph, {}, solver, [&](const ReplayStep& step) {
    marginals.Update();
    if ((step.index + 1) % interval == 0) {
      worst.Widen(testing::CompareWithCholmod(solver, marginals, 20));
      ++samples;
    }
    return step.index + 1 < steps;
  });
  std::cout << samples << " samples, off by " << worst.kept << ", CHOLMOD's plain inverse by " << worst.cholmod << '\n';
  EXPECT_EQ(samples, steps / interval);
  EXPECT_LT(worst.kept, std::max(1e-7, 4 * worst.cholmod));
}

TEST(CovarianceDataTest, Sphere2500EqualsCholmod) {
  TERSE_NEEDS(file, "graphs/3d/sphere2500.g2o");
  ExpectEqualCholmod(file, {1000, 200});
}

TEST(CovarianceDataTest, ParkingGarageEqualsCholmod) {
  TERSE_NEEDS(file, "graphs/3d/parking-garage.g2o");
  ExpectEqualCholmod(file, {1600, 400});
}

}  // namespace
}  // namespace terse
