// What a compact run leaves behind, written and read by the library alone: the map, its thresholds, the run's folder.

#include <gtest/gtest.h>
#include <stdlib.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "terse/compact/compact_graph.h"
#include "terse/compact/map_file.h"
#include "terse/compact/run_folder.h"
#include "terse/compact/run_writer.h"
#include "terse/compact/thresholds_file.h"
#include "terse/core/error.h"
#include "terse/core/writable.h"
#include "testing_files.h"
#include "testing_scene.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

class TestFolder {
 public:
  TestFolder() {
    std::string name = ::testing::TempDir() + "terse_compact_files_XXXXXX";
    path_ = ::mkdtemp(name.data());
  }
  ~TestFolder() { fs::remove_all(path_); }
  std::string At(const std::string& name) const { return path_ + '/' + name; }
  const std::string& Path() const { return path_; }

 private:
  std::string path_;
};

std::string Content(const std::string& path) {
  std::ostringstream out;
  out << std::ifstream(path, std::ios::binary).rdbuf();
  return out.str();
}

template <class Pose>
struct FileScene {
  explicit FileScene(std::uint64_t seed, int poses = 50) {
    testing::Random rng(seed);
    testing::RandomGraphOptions scene_options;
    scene_options.poses = poses;
    scene_options.noise = 0.05;
    scene_options.id_stride = 3;
    scene_options.priors = true;
    graph = testing::MakeRandomGraph<Pose>(rng, scene_options).graph;
    replay.emplace(graph);
    options.strategy = Strategy::kFpfl;
    options.thresholds.range = replay->LinkRange();
    options.thresholds.link_covariance = replay->LinkCovariance();
    options.thresholds.min_loop_gain = 0.3;
    options.thresholds.min_pose_gain = 2.5;
  }
  PoseGraph<Pose> graph;
  std::optional<GraphReplay<Pose>> replay;
  CompactOptions<Pose> options;
};

template <class Pose>
class CompactFilesTest : public ::testing::Test {};
using Groups = ::testing::Types<SE2, SE3>;
TYPED_TEST_SUITE(CompactFilesTest, Groups);

TYPED_TEST(CompactFilesTest, AMapReadsBackAndGoesOn) {
  using Pose = TypeParam;
  const TestFolder folder;
  const FileScene<Pose> scene(1);
  CompactPoseSlam<Pose> slam(scene.options);
  const auto before = static_cast<std::size_t>(30);
  for (std::size_t k = 0; k < before; ++k) slam.AddPose(scene.replay->Inputs()[k]);
  const CompactMap<Pose> map = slam.Export();
  InformationScale scale;
  scale.loops.rotation = 1.0 / 3;
  WriteCompactMap(map, Strategy::kApfl, folder.At("graph.json"), scale);
  WriteThresholds(scene.options.thresholds, folder.At("thresholds.json"));

  const CompactMapFile file = ReadCompactMap(folder.At("graph.json"));
  EXPECT_EQ(file.strategy, Strategy::kApfl);
  EXPECT_EQ(file.information_scale.loops.rotation, scale.loops.rotation);
  EXPECT_EQ(file.information_scale.odometry.translation, 1);
  const auto* read = std::get_if<CompactMap<Pose>>(&file.map);
  ASSERT_NE(read, nullptr);
  ASSERT_EQ(read->poses.size(), before);
  ASSERT_EQ(read->edges.size(), map.edges.size());
  EXPECT_EQ(read->priors.size(), map.priors.size());
  for (std::size_t k = 0; k < map.edges.size(); ++k) {
    EXPECT_EQ(read->edges[k].factor, map.edges[k].factor);
    EXPECT_EQ(read->edges[k].measured.information, map.edges[k].measured.information);
    EXPECT_EQ(read->edges[k].composed_of, map.edges[k].composed_of);
  }
  CompactOptions<Pose> options;
  options.strategy = scene.options.strategy;
  EXPECT_EQ(ReadThresholdsDimension(folder.At("thresholds.json")), Pose::kDim);
  options.thresholds = ReadThresholds<Pose>(folder.At("thresholds.json"));
  EXPECT_EQ(options.thresholds.range, scene.options.thresholds.range);
  EXPECT_EQ(options.thresholds.link_covariance, scene.options.thresholds.link_covariance);
  EXPECT_EQ(options.thresholds.min_pose_gain, scene.options.thresholds.min_pose_gain);

  // It goes on as the map that was never written.
  auto from_memory = CompactPoseSlam<Pose>::Restore(map, scene.options);
  auto from_file = CompactPoseSlam<Pose>::Restore(*read, options);
  for (std::size_t k = before; k < scene.replay->Inputs().size(); ++k) {
    const Decision a = from_memory.AddPose(scene.replay->Inputs()[k]);
    const Decision b = from_file.AddPose(scene.replay->Inputs()[k]);
    EXPECT_EQ(a.verdict, b.verdict);
    EXPECT_EQ(a.links_accepted, b.links_accepted);
  }
  // Rotations are made unit again when they are read, which may change their last bit.
  const double chi2 = from_memory.Finish().chi2;
  EXPECT_NEAR(from_file.Finish().chi2, chi2, 1e-9 * chi2);
}

struct Counts {
  int candidates = 0, accepted = 0, retired = 0;
};

// What ReadRunFolder gives is what the run decided.
template <class Pose>
void ExpectAFolderHoldsTheRun(const FileScene<Pose>& scene, Counts& counts) {
  const TestFolder folder;
  StepRecorder<Pose> recorder(static_cast<int>(scene.graph.Poses().size()));
  const CompactRun<Pose> run = RunCompact<Pose>(
      CompactPoseSlam<Pose>(scene.options), *scene.replay,
      [&](const CompactPoseSlam<Pose>& slam, const Decision& decision, double s) { recorder.Add(slam, decision, s); });
  const RunTrajectories trajectories = MakeRunTrajectories(run.slam, Recovery::kV2, nullptr);
  RunResults<Pose> results{run.slam, run.result, run.decisions, recorder.Steps(), trajectories};
  results.retired_at_end = run.retired;
  WriteRun(results, folder.Path());
  EXPECT_THROW(ReadRunFolder(folder.Path()), FileError) << "stats.json is the caller's";
  const std::string stats = "{\"poses_kept\": " + std::to_string(run.PosesKept()) +
                            ", \"links_kept\": " + std::to_string(run.LinksKept()) + ", \"more\": [1.50]}";
  std::ofstream(folder.At("stats.json")) << stats;

  const RunFolder read = ReadRunFolder(folder.Path());
  EXPECT_EQ(read.dimension, Pose::kDim);
  EXPECT_EQ(read.min_loop_gain, scene.options.thresholds.min_loop_gain);
  EXPECT_EQ(read.min_pose_gain, scene.options.thresholds.min_pose_gain);
  EXPECT_EQ(read.stats_json, stats);
  EXPECT_EQ(read.thresholds_json, Content(folder.At("thresholds.json")));
  EXPECT_FALSE(read.ate_m || read.T_world_body_true);
  EXPECT_EQ(read.links.size(), static_cast<std::size_t>(run.LinksKept()));
  EXPECT_EQ(read.covariances.size(), static_cast<std::size_t>(run.PosesKept()));
  ASSERT_EQ(read.decisions.size(), run.decisions.size());
  const auto expect_ids = [&](const std::vector<int>& poses, const std::vector<PoseId>& ids) {
    ASSERT_EQ(poses.size(), ids.size());
    for (std::size_t p = 0; p < poses.size(); ++p) {
      EXPECT_EQ(read.ids[static_cast<std::size_t>(poses[p])], ids[p].value);
    }
  };
  for (std::size_t k = 0; k < run.decisions.size(); ++k) {
    const Decision& decided = run.decisions[k];
    const RunDecision& found = read.decisions[k];
    EXPECT_EQ(read.ids[k], decided.id.value);
    EXPECT_EQ(found.verdict, Name(decided.verdict));
    EXPECT_EQ(found.pose_gain, decided.pose_gain);
    EXPECT_EQ(found.registrations_tried, decided.registrations_tried);
    EXPECT_EQ(found.links_accepted, decided.links_accepted);
    EXPECT_EQ(found.links_refused, decided.links_refused);
    ASSERT_EQ(found.candidates.size(), decided.candidates.size());
    for (std::size_t c = 0; c < found.candidates.size(); ++c) {
      const Candidate& a = decided.candidates[c];
      const RunCandidate& b = found.candidates[c];
      EXPECT_EQ(read.ids[static_cast<std::size_t>(b.pose)], a.id.value);
      EXPECT_EQ(b.probability, a.probability);
      EXPECT_EQ(b.gain, a.gain);
      EXPECT_EQ(b.measured_gain, a.measured_gain);
      EXPECT_EQ(b.innovation, a.innovation);
      EXPECT_EQ(b.tried, a.tried);
      EXPECT_EQ(b.measured, a.measured);
      EXPECT_EQ(b.accepted, a.accepted);
      ++counts.candidates;
      counts.accepted += b.accepted;
    }
    std::vector<PoseId> retired;
    for (const RetiredPose& pose : decided.retired) retired.push_back(pose.id);
    if (k + 1 == run.decisions.size()) {
      for (const RetiredPose& pose : run.retired) retired.push_back(pose.id);
    }
    expect_ids(found.retired, retired);
    expect_ids(found.revived, decided.revived);
    counts.retired += static_cast<int>(retired.size());
  }
}

TYPED_TEST(CompactFilesTest, AFolderHoldsTheRun) {
  FileScene<TypeParam> scene(2);
  for (const Strategy strategy : {Strategy::kFpfl, Strategy::kBounded}) {
    SCOPED_TRACE(Name(strategy));
    scene.options.strategy = strategy;
    scene.options.retire_share = 20;
    Counts counts;
    ExpectAFolderHoldsTheRun(scene, counts);
    if (strategy == Strategy::kFpfl) {
      EXPECT_GT(counts.candidates, counts.accepted);
    }
    EXPECT_GT(counts.accepted, 0);
    EXPECT_EQ(counts.retired > 0, strategy == Strategy::kBounded);
  }
}

TYPED_TEST(CompactFilesTest, ARunIsEndedByItsWatch) {
  using Pose = TypeParam;
  const FileScene<Pose> scene(3);
  CompactPoseSlam<Pose> slam(scene.options), whole(scene.options);
  const auto first = AddPoses<Pose>(slam, *scene.replay, [&](const Decision& decision, double seconds) {
    EXPECT_GE(seconds, 0);
    return decision.id != scene.replay->Inputs()[6].id;
  });
  ASSERT_EQ(first.size(), 7u);
  EXPECT_EQ(slam.PosesSeen(), 7);
  const auto all = AddPoses(whole, *scene.replay);
  ASSERT_EQ(all.size(), scene.replay->Inputs().size());
  for (std::size_t k = 0; k < first.size(); ++k) EXPECT_EQ(first[k].pose_gain, all[k].pose_gain);
}

TEST(CompactFilesTest, ABadMapIsRefusedAtItsPlaceAndABadEstimateIsNotWritten) {
  const TestFolder folder;
  const FileScene<SE2> scene(4, 12);
  CompactPoseSlam<SE2> slam(scene.options);
  AddPoses(slam, *scene.replay);
  CompactMap<SE2> map = slam.Export();
  WriteCompactMap(map, Strategy::kFpfl, folder.At("graph.json"));
  const std::string text = Content(folder.At("graph.json"));
  map.poses[3].T_world_body = SE2(std::nan(""), 0, 0);
  EXPECT_THROW(WriteCompactMap(map, Strategy::kFpfl, folder.At("graph.json")), NumericalError);
  EXPECT_EQ(Content(folder.At("graph.json")), text);

  const std::string key = "\"T_world_body\"";
  std::ofstream(folder.At("bad.json")) << std::string(text).replace(text.find(key), key.size(), "\"T\"");
  try {
    ReadCompactMap(folder.At("bad.json"));
    ADD_FAILURE();
  } catch (const FileError& error) {
    EXPECT_EQ(error.path(), folder.At("bad.json"));
    EXPECT_EQ(error.cause(), "poses[0].T_world_body: missing, expected [x, y, theta]");
  }
}

TEST(WritableTest, FoldersAreMadeAndWhatIsInTheWayIsNamed) {
  const TestFolder folder;
  RequireFolder(folder.At("a/b"), "file");
  EXPECT_TRUE(fs::is_directory(folder.At("a/b")));
  EXPECT_TRUE(fs::is_empty(folder.At("a/b"))) << "the trial is removed";
  std::ofstream(folder.At("taken")) << "text";
  const auto cause = [](const auto& work) -> std::string {
    try {
      work();
    } catch (const FileError& error) {
      return error.path() + ": " + error.cause();
    }
    return "";
  };
  EXPECT_EQ(cause([&] { RequireFolder(folder.At("taken"), "file"); }),
            folder.At("taken") + ": cannot make this folder: a file of this name is in the way");
  fs::create_directory(folder.At("a/b/file"));
  EXPECT_NE(cause([&] { RequireFolder(folder.At("a/b"), "file"); }), "") << "a folder where the file is to be";
  EXPECT_EQ(cause([&] { RequireWritable(folder.At("new")); }), "");
  EXPECT_FALSE(fs::exists(folder.At("new")));
  EXPECT_EQ(cause([] { RequireWritable(""); }), "");
  EXPECT_EQ(cause([] { RequireWritable("/dev/null"); }), "");
  EXPECT_NE(cause([&] { RequireWritable(folder.At("taken/below")); }), "");
}

}  // namespace
}  // namespace terse
