// Public data sets against their published optima, the incremental solver against the batch optimum along the way,
// and compact runs over whole sets.
//
// chi2 = sum of r' Omega r, no 1/2. Tolerance: 1e-5 relative, or half a unit of the last digit that was published.
// Builds with sanitizers take the smaller sets and a part of each run.

#include <gtest/gtest.h>

#include <algorithm>
#include <iostream>

#include "shared_data.h"
#include "terse/compact/thresholds.h"
#include "terse/core/graph_file.h"
#include "terse/core/initial_values.h"
#include "terse/core/replay.h"

namespace terse {
namespace {

template <class Pose>
PoseGraph<Pose> Load(const std::string& path, RotationInformation reading = RotationInformation::kQuaternion) {
  ReadOptions options;
  options.rotation_information = reading;
  return std::get<PoseGraph<Pose>>(ReadGraph(path, options).graph);
}

template <class Pose>
double Optimum(const PoseGraph<Pose>& graph, InitialValues start = InitialValues::kCompose) {
  const auto result = SolveBatch(graph, ComputeInitialValues(graph, start));
  EXPECT_TRUE(result.Converged()) << result.message;
  return result.chi2;
}

struct Published {
  double chi2, tolerance;
};
// The relative tolerance, but not finer than the digits printed.
Published Printed(double chi2, double half_a_digit) { return {chi2, std::max(1e-5 * chi2, half_a_digit)}; }
void ExpectOptimum(double chi2, const Published& published) { EXPECT_NEAR(chi2, published.chi2, published.tolerance); }

constexpr auto kCompose = InitialValues::kCompose;
constexpr auto kFile = InitialValues::kFile;
constexpr auto kTree = InitialValues::kTree;
constexpr auto kChordal = InitialValues::kChordal;
constexpr auto kRadians = RotationInformation::kRadians;

TEST(PublicDataTest, ParkingGarage) {
  TERSE_NEEDS(file, "graphs/3d/parking-garage.g2o");
  ExpectOptimum(Optimum(Load<SE3>(file)), Printed(1.2387, 0.5e-4));
  ExpectOptimum(Optimum(Load<SE3>(file, kRadians)), Printed(1.26838, 0.5e-5));
}

TEST(PublicDataTest, Sphere2500) {
  TERSE_NEEDS(file, "graphs/3d/sphere2500.g2o");
  const double chi2 = Optimum(Load<SE3>(file));
  EXPECT_GT(chi2, 727);
  EXPECT_LT(chi2, 730);
  // Exact Jacobians. Approximate ones, GTSAM's default, stop at 1351.48.
  ExpectOptimum(Optimum(Load<SE3>(file, kRadians)), Printed(1351.40, 0.005));
}

TEST(PublicDataTest, Torus3D) {
  TERSE_NEEDS(file, "graphs/3d/torus3D.g2o");
  // GTSAM ends at 24239 with approximate Jacobians.
  const double chi2 = Optimum(Load<SE3>(file, kRadians), kChordal);
  EXPECT_GE(chi2, 24235);
  EXPECT_LE(chi2, 24239);
}

TEST(PublicDataTest, SmallGrid3D) {
  TERSE_NEEDS(file, "graphs/3d/smallGrid3D.g2o");
  const auto graph = Load<SE3>(file, kRadians);
  // 1039.40 was published: where approximate Jacobians stop. The cost is the same, exact ones get lower.
  for (const auto start : {kCompose, kFile, kTree, kChordal}) {
    const double chi2 = Optimum(graph, start);
    EXPECT_LE(chi2, 1039.40);
    ExpectOptimum(chi2, Printed(1035.8507, 0));
  }
}

TEST(PublicDataTest, SphereBignoise) {
  TERSE_NEEDS(file, "graphs/3d/sphere_bignoise_vertex3.g2o");
  EXPECT_GT(Optimum(Load<SE3>(file), kChordal), 0);  // and converged
}

TEST(PublicDataTest, City10000) {
  TERSE_NEEDS(file, "graphs/2d/city10000.g2o");
  ExpectOptimum(Optimum(Load<SE2>(file), kChordal), Printed(511.985, 0.0005));
}

TEST(PublicDataTest, Manhattan) {
  TERSE_NEEDS(file, "graphs/2d/manhattan.g2o");
  const auto graph = Load<SE2>(file);
  for (const auto start : {kCompose, kTree, kChordal}) ExpectOptimum(Optimum(graph, start), Printed(3549.04, 0.005));
  EXPECT_THROW(ComputeInitialValues(graph, kFile), std::invalid_argument) << "this file has no vertices";
}

TEST(PublicDataTest, HogMan) {
  TERSE_NEEDS(file, "graphs/2d/w10000_hogman.graph");
  const auto graph = Load<SE2>(file);
  for (const auto start : {kFile, kTree, kChordal}) ExpectOptimum(Optimum(graph, start), Printed(171545.45, 0.005));
}

TEST(PublicDataTest, InputM3500) {
  TERSE_NEEDS(file, "graphs/2d/input_M3500_g2o.g2o");
  const auto graph = Load<SE2>(file);
  for (const auto start : {kCompose, kFile, kTree, kChordal}) {
    ExpectOptimum(Optimum(graph, start), Printed(137.913, 0.0005));
  }
}

// The same edges for a residual that is not rotated into the measurement's frame: r' = diag(R_z, 1) r.
PoseGraph<SE2> WithUnrotatedResidual(const PoseGraph<SE2>& graph) {
  PoseGraph<SE2> out;
  for (const auto& node : graph.Poses()) out.AddPose(node.id, node.T_world_body);
  for (const auto& node : graph.Factors()) {
    auto edge = std::get<RelativePoseFactor<SE2>>(node.factor);
    Matrix<3, 3> R = Matrix<3, 3>::Identity();
    R.topLeftCorner<2, 2>() = edge.T_from_to.Rotation();
    const Matrix<3, 3> rotated = R.transpose() * edge.information * R;
    edge.information = (rotated + rotated.transpose()) / 2;
    out.AddFactor(edge);
  }
  return out;
}

// The gating paper's sets. It prints chi2 divided by the number of scalars, of the residual that this library uses
// (0.0102983, 0.0110797, 0.0485121 for the first three). Elsewhere the same files are cited with a residual that is not
// rotated into the measurement's frame; both readings are reproduced.
TEST(PublicDataTest, GatingPaper) {
  struct Set {
    const char* name;
    double rotated, unrotated, per_scalar;
  };
  for (const Set& set : {Set{"FR079", 37.599, 38.845, 0.0102983}, Set{"CSAIL", 38.956, 40.555, 0.0110797},
                         Set{"Intel", 215.830, 214.171, 0.0485121}}) {
    SCOPED_TRACE(set.name);
    TERSE_NEEDS(file, "graphs/igg_spo/" + std::string(set.name) + ".g2o");
    const auto graph = Load<SE2>(file);
    const double chi2 = Optimum(graph);
    ExpectOptimum(chi2, Printed(set.rotated, 0.0005));
    EXPECT_NEAR(chi2 / (3 * static_cast<double>(graph.Factors().size())), set.per_scalar, 1e-5 * set.per_scalar);
    ExpectOptimum(Optimum(WithUnrotatedResidual(graph)), Printed(set.unrotated, 0.0005));
  }
}

// The default start, on every set whose optimum is known and which is quick.
TEST(PublicDataTest, TheAutomaticStartReachesTheOptimum) {
  struct Set {
    const char* path;
    double chi2;
  };
  for (const Set& set :
       {Set{"2d/manhattan.g2o", 3549.04}, Set{"2d/input_M3500_g2o.g2o", 137.913},
        Set{"2d/w10000_hogman.graph", 171545.45}, Set{"2d/city10000.g2o", 511.985}, Set{"2d/intel.g2o", 45.0047},
        Set{"igg_spo/MIT.g2o", 41.163}, Set{"igg_spo/MIT-P.g2o", 43.409}, Set{"igg_spo/FR079.g2o", 37.599},
        Set{"igg_spo/CSAIL.g2o", 38.956}, Set{"igg_spo/Intel.g2o", 215.830}, Set{"mac/kitti_02.g2o", 78.7643},
        Set{"mac/kitti_05.g2o", 157.104}, Set{"mac/ais2klinik.g2o", 172.816}}) {
    SCOPED_TRACE(set.path);
    TERSE_NEEDS(file, "graphs/" + std::string(set.path));
    ExpectOptimum(Optimum(Load<SE2>(file), InitialValues::kAuto), Printed(set.chi2, 0.0005));
  }
  for (const Set& set :
       {Set{"3d/parking-garage.g2o", 1.23869}, Set{"3d/sphere2500.g2o", 727.285},
        Set{"3d/sphere_bignoise_vertex3.g2o", 753100}, Set{"3d/smallGrid3D.g2o", 464.145},
        Set{"real/copslam_KITTI_02_vo.g2o", 0.759789}, Set{"real/turtlezhong_kitti_02.g2o", 0.00921657},
        Set{"real/lidarslam_nuc_pose_graph.g2o", 20.6068}}) {
    SCOPED_TRACE(set.path);
    TERSE_NEEDS(file, "graphs/" + std::string(set.path));
    ExpectOptimum(Optimum(Load<SE3>(file), InitialValues::kAuto), {set.chi2, 1e-5 * set.chi2});
  }
}

// Composed odometry ends in a wrong minimum. The incremental solver, which went there little by little, finds out at
// the end.
TEST(PublicDataTest, IncrementalLeavesTheWrongMinimumOfSphereBignoise) {
  TERSE_NEEDS(file, "graphs/3d/sphere_bignoise_vertex3.g2o");
  IncrementalSolver<SE3> solver;
  Replay<SE3>(Load<SE3>(file), {}, solver);
  EXPECT_GT(solver.Chi2(), 8e5);
  EXPECT_NEAR(solver.Finish().chi2, 753100, 10);
  EXPECT_EQ(solver.Restarts(), 1);
}

TEST(PublicDataTest, MitNeedsAGoodStart) {
  for (const auto& [name, chi2] : {std::pair{"MIT", 41.163}, std::pair{"MIT-P", 43.409}}) {
    SCOPED_TRACE(name);
    TERSE_NEEDS(file, "graphs/igg_spo/" + std::string(name) + ".g2o");
    const auto graph = Load<SE2>(file);
    for (const auto start : {kTree, kChordal}) ExpectOptimum(Optimum(graph, start), Printed(chi2, 0.0005));
  }
}

// One pose per step; every 50th step against the batch optimum of what has arrived, from the incremental estimate.
template <class Pose>
void CompareAlongTheWay(const std::string& path) {
  const auto graph = Load<Pose>(path);
  IncrementalSolver<Pose> solver;
  double sum = 0, worst = 0;
  int compared = 0;
  const auto compare = [&](int step) {
    const auto optimum = SolveBatch(solver.Graph(), solver.Estimates());
    ASSERT_TRUE(optimum.Converged()) << "step " << step << ": " << optimum.message;
    const double chi2 = solver.Chi2();
    // Before the first loop the optimum is 0 but for rounding, and a ratio says nothing.
    if (optimum.chi2 < 1e-9 * step) {
      EXPECT_LT(chi2, 1e-6 * step) << "step " << step;
      return;
    }
    const double gap = chi2 / optimum.chi2 - 1;
    EXPECT_GT(gap, -1e-8) << "step " << step << ": below the optimum";
    sum += gap;
    worst = std::max(worst, gap);
    ++compared;
  };
  Replay<Pose>(graph, {}, solver, [&](const ReplayStep& step) {
    if ((step.index + 1) % 50 == 0) compare(step.index + 1);
    return !::testing::Test::HasFatalFailure() && !(kSlowBuild && step.index >= 300);
  });
  ASSERT_GT(compared, 0);
  std::cout << path.substr(path.rfind('/') + 1) << ": mean gap " << sum / compared << ", worst " << worst << " of "
            << compared << " comparisons\n";
  EXPECT_LE(sum / compared, 1e-3);
}

TEST(PublicDataTest, IncrementalStaysNearTheOptimumOnParkingGarage) {
  TERSE_NEEDS(file, "graphs/3d/parking-garage.g2o");
  CompareAlongTheWay<SE3>(file);
}
TEST(PublicDataTest, IncrementalStaysNearTheOptimumOnManhattan) {
  TERSE_NEEDS(file, "graphs/2d/manhattan.g2o");
  CompareAlongTheWay<SE2>(file);
}
TEST(PublicDataTest, IncrementalStaysNearTheOptimumOnSphere2500) {
  TERSE_NEEDS(file, "graphs/3d/sphere2500.g2o");
  CompareAlongTheWay<SE3>(file);
}

// At step 1662 a loop comes in on a pose that is 0.16 rad from its linearisation point: what linearising it there costs
// is seen in that step, not only when the interval comes round.
TEST(PublicDataTest, ALoopOntoPosesFarFromTheirPointsIsSeenAtOnce) {
  TERSE_NEEDS(file, "graphs/2d/manhattan.g2o");
  IncrementalSolver<SE2> solver;
  double worst = 0;
  Replay<SE2>(Load<SE2>(file), {}, solver, [&](const ReplayStep& step) {
    if (step.index >= 1660)
      worst = std::max(worst, solver.Chi2() / SolveBatch(solver.Graph(), solver.Estimates()).chi2);
    return step.index < 1666;
  });
  EXPECT_LT(worst, 1.01);
}

// Few poses, few links, with thresholds from a sample of the set, as the command does it.
template <class Pose>
void RunFewPosesFewLinks(const PoseGraph<Pose>& graph, const std::string& path, Strategy strategy) {
  SCOPED_TRACE(Name(strategy));
  GraphReplay<Pose> replay(graph);
  CompactOptions<Pose> options;
  options.strategy = strategy;
  SampleOptions sample;
  sample.strategy = strategy;
  options.thresholds = SelectThresholds(graph, sample).thresholds;
  CompactPoseSlam<Pose> slam(options);
  std::size_t kept = 0;
  for (const auto& input : replay.Inputs()) {
    const Decision decision = slam.AddPose(input);
    kept += (decision.Kept() ? 1 : 0) + decision.revived.size() - decision.retired.size();
  }
  EXPECT_TRUE(slam.Finish().Converged());
  EXPECT_EQ(slam.Solver().Graph().Poses().size(), kept);
  std::cout << path.substr(path.rfind('/') + 1) << ": kept " << kept << " of " << graph.Poses().size() << " poses, "
            << slam.LinksKept() << " of " << replay.LinksOffered() << " links\n";
  EXPECT_LT(kept, graph.Poses().size());
  EXPECT_GT(slam.LinksKept(), 0);
  const auto trajectory = slam.Trajectory();
  ASSERT_EQ(trajectory.size(), graph.Poses().size());
  for (const auto& pose : trajectory) EXPECT_TRUE(graph.HasPose(pose.id));
}
template <class Pose>
void RunFewPosesFewLinks(const std::string& path) {
  const auto graph = Load<Pose>(path);
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) RunFewPosesFewLinks(graph, path, strategy);
}

TEST(PublicDataTest, CompactRunOverParkingGarage) {
  TERSE_NEEDS(file, "graphs/3d/parking-garage.g2o");
  RunFewPosesFewLinks<SE3>(file);
}
TEST(PublicDataTest, CompactRunOverManhattan) {
  TERSE_NEEDS(file, "graphs/2d/manhattan.g2o");
  RunFewPosesFewLinks<SE2>(file);
}

}  // namespace
}  // namespace terse
