// What trajectories are compared with: derived truths against the generator's and against the public data.

#include "run/ground_truth.h"

#include <gtest/gtest.h>

#include <filesystem>

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

TEST(ComputeAte, IsThatOfAllErrors) {
  const auto scene = MakeScene<SE3>(Scene::kSphere, 200, 2);
  const Reference<SE3> reference{ReferenceKind::kExact, scene.truth};
  auto estimate = AsEstimate(scene.graph, BatchOptimum(scene.graph).T_world_body);
  std::swap(estimate[3], estimate[100]);
  EXPECT_DOUBLE_EQ(ComputeAte(scene.graph, reference, estimate),
                   ComputeErrors(scene.graph, reference, estimate).ate.translation_m);
}

TEST(FindReference, TakesAFileBesideTheGraphFirst) {
  const auto scene = MakeScene<SE2>(Scene::kManhattan, 100, 3);
  EXPECT_EQ(FindReference(scene.graph, "nowhere/walk.g2o", "nowhere").kind, ReferenceKind::kGrid);
  std::string text;
  for (int k = 0; k < 100; ++k) text += std::to_string(k) + " " + std::to_string(k) + " 0 0 0 0 0 1\n";
  const TestFile truth("walk.tum", text);
  const auto found = FindReference(scene.graph, std::filesystem::path(truth.Path()).replace_extension(".g2o"), "");
  ASSERT_EQ(found.kind, ReferenceKind::kFile);
  EXPECT_EQ(found.T_world_body[7].Translation().x(), 7);
  const auto sphere = MakeScene<SE3>(Scene::kSphere, 100);
  EXPECT_EQ(FindReference(sphere.graph, "nowhere/sphere.g2o", "nowhere").kind, ReferenceKind::kOptimum);
}

// Against the errors themselves, of graphs that differ in their noise.
template <class Pose>
void ExpectErrorsAsExpected(Scene kind, long poses) {
  double squares = 0, expected = 0;
  const int draws = kSlowBuild ? 10 : 40;
  for (int seed = 1; seed <= draws; ++seed) {
    const auto scene = MakeScene<Pose>(kind, poses, static_cast<std::uint64_t>(seed));
    BatchResult<Pose> optimum = BatchOptimum(scene.graph);
    const Reference<Pose> reference{ReferenceKind::kExact, scene.truth};
    const double ate = ComputeAte(scene.graph, reference, AsEstimate(scene.graph, optimum.T_world_body));
    squares += ate * ate / draws;
    const double sigma = ExpectedErrorOf(scene.graph, std::move(optimum));
    expected += sigma * sigma / draws;
  }
  std::printf("expected %.4f m, found %.4f m\n", std::sqrt(expected), std::sqrt(squares));
  // Few modes make most of the error: its square spreads by about as much as it is, so the mean of 40 by a sixth.
  EXPECT_NEAR(squares / expected, 1, kSlowBuild ? 0.9 : 0.45);
}

TEST(ExpectedErrorOf, IsWhatErrorsAre) {
  ExpectErrorsAsExpected<SE2>(Scene::kManhattan, 120);
  ExpectErrorsAsExpected<SE3>(Scene::kSphere, 120);
}

}  // namespace
}  // namespace terse
