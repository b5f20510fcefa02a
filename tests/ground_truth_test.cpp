// What trajectories are compared with: derived truths against the generator's and against the public data.

#include "run/ground_truth.h"

#include <gtest/gtest.h>

#include "shared_data.h"
#include "terse/core/error.h"
#include "terse/core/graph_file.h"
#include "terse/core/trajectory.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

using testing::MakeScene;

template <class Pose>
PoseGraph<Pose> ReadAs(const std::string& path) {
  return std::get<PoseGraph<Pose>>(ReadGraph(path).graph);
}

template <class Pose>
std::vector<RecoveredPose<Pose>> AsEstimate(const PoseGraph<Pose>& graph, const std::vector<Pose>& poses) {
  std::vector<RecoveredPose<Pose>> out;
  for (std::size_t k = 0; k < poses.size(); ++k) out.push_back({graph.Poses()[k].id, true, poses[k]});
  return out;
}

TEST(GridTruth, IsTheGeneratorsButForTheFrame) {
  const auto scene = MakeScene<SE2>(Scene::kManhattan, 400, 3);
  const auto truth = GridTruth(scene.graph);
  ASSERT_TRUE(truth);
  for (std::size_t k = 0; k < truth->size(); ++k) {
    const SE2 expected = scene.truth.front().Inverse() * scene.truth[k];
    EXPECT_LT((*truth)[k].Local(expected).norm(), 1e-6) << k;
  }
}

TEST(GridTruth, IsAbsentWhereAnEdgeDisagrees) {
  auto scene = MakeScene<SE2>(Scene::kManhattan, 100);
  RelativePoseFactor<SE2> wrong{{3}, {90}, scene.truth[3].Inverse() * scene.truth[90], Matrix<3, 3>::Identity()};
  scene.graph.AddFactor(wrong);
  EXPECT_TRUE(GridTruth(scene.graph));
  wrong.T_from_to = wrong.T_from_to * SE2(1, 0, 0);
  const FactorId id = scene.graph.AddFactor(wrong);
  EXPECT_FALSE(GridTruth(scene.graph));
  scene.graph.RemoveFactor(id);
  wrong.T_from_to = scene.truth[3].Inverse() * scene.truth[90] * SE2(0, 0, 1.5);
  scene.graph.AddFactor(wrong);
  EXPECT_FALSE(GridTruth(scene.graph));
}

TEST(GridTruth, FitsThePublicGrids) {
  TERSE_NEEDS(folder, "graphs/2d");
  for (const char* name : {"manhattan.g2o", "city10000.g2o", "w10000_hogman.graph"}) {
    EXPECT_TRUE(GridTruth(ReadAs<SE2>(folder + '/' + name))) << name;
  }
  EXPECT_FALSE(GridTruth(ReadAs<SE2>(folder + "/intel.g2o"))) << "is no grid";
}

TEST(SphereTruth, IsWhereTheOptimumIs) {
  TERSE_NEEDS(path, "graphs/3d/sphere2500.g2o");
  const auto graph = ReadAs<SE3>(path);
  auto truth = SphereTruth(graph);
  ASSERT_TRUE(truth);
  const std::size_t poses = kSlowBuild ? 500 : truth->size();
  truth->resize(poses);
  const auto part = testing::FirstPoses(graph, poses);
  const auto errors =
      ComputeErrors(part, {ReferenceKind::kSphere, *truth}, AsEstimate(part, BatchOptimum(part).T_world_body));
  EXPECT_NEAR(errors.ate.translation_m, kSlowBuild ? 0.8286 : 0.7816, 1e-3);
  EXPECT_LT(errors.ate.rotation_deg, 2) << "the frame on the sphere";
  EXPECT_LT(errors.rpe.rotation_deg, 3);
}

TEST(SphereTruth, IsOfThatGraphOnly) {
  EXPECT_FALSE(SphereTruth(MakeScene<SE3>(Scene::kSphere, 100).graph));
  EXPECT_FALSE(SphereTruth(MakeScene<SE3>(Scene::kSphere, 2500).graph)) << "another sphere";
}

TEST(ReadTruth, MatchesIdsOrLines) {
  PoseGraph<SE2> graph;
  for (const std::int64_t id : {20, 10, 40}) graph.AddPose({id});
  const TestFile ids("ids.tum", "10 1 0 0 0 0 0 1\n20 2 0 0 0 0 0 1\n30 3 0 0 0 0 0 1\n40 4 0 0 0 0 0 1\n");
  auto truth = ReadTruth(graph, ids.Path());
  EXPECT_EQ(truth[0].Translation().x(), 2);
  EXPECT_EQ(truth[1].Translation().x(), 1);
  EXPECT_EQ(truth[2].Translation().x(), 4);
  const TestFile seconds("seconds.tum", "0.5 1 0 0 0 0 0 1\n0.6 2 0 0 0 0 1 0\n0.7 4 0 0 0 0 0 1\n");
  truth = ReadTruth(graph, seconds.Path());
  EXPECT_EQ(truth[0].Translation().x(), 2);
  EXPECT_NEAR(truth[0].Angle(), M_PI, 1e-12);
  EXPECT_EQ(truth[1].Translation().x(), 1);
  const TestFile few("few.tum", "10 1 0 0 0 0 0 1\n40 2 0 0 0 0 0 1\n");
  EXPECT_THROW(ReadTruth(graph, few.Path()), std::invalid_argument);
  EXPECT_THROW(ReadTruth(graph, "nowhere.tum"), FileError);
}

TEST(ComputeErrors, TakesEverySoManiethPoseOfMany) {
  const auto scene = MakeScene<SE3>(Scene::kSphere, 300, 2);
  const Reference<SE3> reference{ReferenceKind::kExact, scene.truth};
  const auto estimate = AsEstimate(scene.graph, BatchOptimum(scene.graph).T_world_body);
  const auto all = ComputeErrors(scene.graph, reference, estimate);
  EXPECT_EQ(all.stride, 1);
  EXPECT_GT(all.ate.translation_m, 0);
  const auto some = ComputeErrors(scene.graph, reference, estimate, 100);
  EXPECT_EQ(some.stride, 3);
  EXPECT_NEAR(some.rpe.translation_m, all.rpe.translation_m, 1e-12) << "of every pose";
  EXPECT_NEAR(some.rpe.rotation_deg, all.rpe.rotation_deg, 1e-9);
  EXPECT_NEAR(some.ate.translation_m, all.ate.translation_m, 0.3 * all.ate.translation_m);
  EXPECT_NEAR(some.rpe_all.rotation_deg, all.rpe_all.rotation_deg, 0.3 * all.rpe_all.rotation_deg);
}

}  // namespace
}  // namespace terse
