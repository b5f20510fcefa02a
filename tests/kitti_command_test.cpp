// terse kitti, run as a user would on a few rendered frames.

#include "terse/core/graph_file.h"
#include "terse/core/trajectory.h"
#include "terse/frontend/kitti_calibration.h"
#include "terse/frontend/png_file.h"
#include "testing_command.h"
#include "testing_street.h"

namespace terse::testing {
namespace {

constexpr int kFrames = 9, kFramesOfRounds = 54;

class KittiCommandTest : public CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    static const ThereAndBack scene = MakeThereAndBack(0, kFrames);
    WriteSequence(scene, kFrames, "street", "truth.txt");
    WriteSequence(scene, kFramesOfRounds, "rounds", "rounds.txt");
  }

  // cheap.json: the defaults but for these.
  void WriteThresholds(double min_loop_gain, double min_pose_gain) const {
    Succeed("kitti street --frames 0:1 --output defaults --quiet");
    auto thresholds = JsonFile("defaults/thresholds.json");
    thresholds["min_loop_gain"] = min_loop_gain;
    thresholds["min_pose_gain"] = min_pose_gain;
    Write("cheap.json", thresholds.dump());
  }

 private:
  // Its frames again and again.
  void WriteSequence(const ThereAndBack& scene, int frames, const std::string& folder, const std::string& truth_file) {
    std::filesystem::create_directories(folder_ / folder / "image_0");
    std::filesystem::create_directories(folder_ / folder / "image_1");
    std::string times;
    Trajectory truth;
    truth.format = TrajectoryFormat::kKitti;
    for (int k = 0; k < frames; ++k) {
      const std::size_t shown = static_cast<std::size_t>(k) % scene.frames.size();
      const std::string name = std::to_string(1000000 + k).substr(1) + ".png";
      WriteGreyPng(Path(folder + "/image_0/" + name), scene.frames[shown].left);
      WriteGreyPng(Path(folder + "/image_1/" + name), scene.frames[shown].right);
      times += std::to_string(0.1 * k) + "\n";
      truth.stamps.push_back(k);
      truth.T_world_body.push_back(scene.T_world_camera[shown]);
    }
    Write(folder + "/times.txt", times);
    WriteKittiCalibration(scene.camera, Path(folder + "/calib.txt"));
    WriteKitti(truth, Path(truth_file));
  }
};

TEST_F(KittiCommandTest, WritesTrajectoryMapLoopsAndStatistics) {
  const Outcome outcome = Succeed("kitti street --output out --strategy apfl --ground-truth truth.txt");
  EXPECT_NE(outcome.out.find("ATE"), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("frames per second"), std::string::npos) << outcome.out;
  EXPECT_EQ(outcome.err, "");
  const Trajectory kitti = ReadTrajectory(Path("out/trajectory.kitti.txt"));
  const Trajectory tum = ReadTrajectory(Path("out/trajectory.tum"));
  ASSERT_EQ(kitti.T_world_body.size(), static_cast<std::size_t>(kFrames));
  ASSERT_EQ(tum.T_world_body.size(), kitti.T_world_body.size());
  EXPECT_NEAR(tum.stamps.back(), 0.1 * (kFrames - 1), 1e-6);
  for (std::size_t k = 0; k < kitti.T_world_body.size(); ++k) {
    EXPECT_LT(kitti.T_world_body[k].Local(tum.T_world_body[k]).norm(), 1e-5);
  }
  const auto graph = std::get<PoseGraph<SE3>>(ReadGraph(Path("out/compact.g2o")).graph);
  EXPECT_EQ(graph.Poses().size(), static_cast<std::size_t>(kFrames));
  const auto stats = JsonFile("out/stats.json");
  EXPECT_EQ(stats.at("frames"), kFrames);
  EXPECT_EQ(stats.at("frames_lost"), 0);
  EXPECT_EQ(stats.at("strategy"), "apfl");
  EXPECT_EQ(stats.at("poses_kept"), kFrames);
  EXPECT_GT(stats.at("fps"), 0);
  EXPECT_GT(stats.at("milliseconds_per_frame").at("odometry"), 0);
  EXPECT_LT(stats.at("errors").at("ate_m"), 0.2);
  EXPECT_TRUE(stats.at("errors").at("t_rel_percent").is_null()) << "shorter than 100 m";
  EXPECT_EQ(CsvRows(Read("out/loops.csv")).size(), stats.at("compared"));
  EXPECT_EQ(CsvRows(Read("out/covariances.csv")).size(), static_cast<std::size_t>(kFrames));
  // A run's folder as compact leaves it.
  EXPECT_EQ(CsvRows(Read("out/decisions.csv")).size(), static_cast<std::size_t>(kFrames));
  const auto steps = CsvRows(Read("out/steps.csv"));
  ASSERT_EQ(steps.size(), static_cast<std::size_t>(kFrames));
  EXPECT_NEAR(std::stod(steps.back()[9]), stats.at("errors").at("ate_m").get<double>(), 0.05);
  EXPECT_TRUE(Exists("out/decisions.jsonl"));
  EXPECT_TRUE(Exists("out/covariances.npz"));
  EXPECT_EQ(ReadTrajectory(Path("out/ground_truth.tum")).stamps, tum.stamps);
  const auto map = JsonFile("out/graph.json");
  ASSERT_EQ(map["poses"].size(), static_cast<std::size_t>(kFrames));
  for (const auto& pose : map["poses"]) {
    const auto id = PoseId{pose["id"].get<std::int64_t>()};
    const auto& p = graph.Poses()[static_cast<std::size_t>(graph.IndexOf(id))].T_world_body->Translation();
    for (int k = 0; k < 3; ++k) {
      EXPECT_NEAR(pose["T_world_body"][static_cast<std::size_t>(k)].get<double>(), p[k], 1e-9);
    }
  }
  // What it wrote is a compact map like any other.
  EXPECT_EQ(JsonFile("out/thresholds.json").at("dimension"), 3);
  Succeed("kitti street --output again --thresholds out/thresholds.json --quiet");
}

TEST_F(KittiCommandTest, CountsPosesThatRetire) {
  const Outcome outcome = Succeed("kitti street --output out --frames 0:4 --retire-share 0.5");
  const auto stats = JsonFile("out/stats.json");
  long retired = 0;
  std::istringstream lines(Read("out/decisions.jsonl"));
  for (std::string line; std::getline(lines, line);) {
    const auto decision = nlohmann::json::parse(line);
    for (const char* key : {"retired", "retired_at_end"}) {
      retired += static_cast<long>(decision.value(key, nlohmann::json::array()).size());
    }
  }
  EXPECT_EQ(stats.at("poses_retired"), retired);
  EXPECT_GE(stats.at("retired_loss_nats"), 0);
  EXPECT_NE(outcome.out.find(" retired; their removal lost "), std::string::npos) << outcome.out;
  EXPECT_FALSE(Succeed("kitti street --output few --frames 0:4 --strategy fpfl").out.empty());
  EXPECT_FALSE(JsonFile("few/stats.json").contains("poses_retired"));
  EXPECT_EQ(JsonFile("out/thresholds.json").at("min_loop_gain"), 4);
  EXPECT_EQ(JsonFile("few/thresholds.json").at("min_loop_gain"), 8) << "each strategy has its own";
  for (const std::string bad : {"-1", "nan"}) {
    ExpectFailure("kitti street --output bad --retire-share " + bad, 2, "--retire-share: " + bad);
  }
  EXPECT_FALSE(Exists("bad"));
}

// Links so cheap that poses are kept for them; all in one place, some retire at the end.
TEST_F(KittiCommandTest, PosesRetireAtTheEnd) {
  WriteThresholds(0.01, 1);
  const std::string run = "kitti rounds --frames 0:45 --thresholds cheap.json --output ";
  Succeed(run + "none --retire-share 0 --quiet");
  const Outcome outcome = Succeed(run + "some --retire-share 500");
  const auto none = JsonFile("none/stats.json"), some = JsonFile("some/stats.json");
  EXPECT_EQ(none.at("poses_retired"), 0);
  EXPECT_GT(some.at("poses_retired"), 0) << none.at("poses_kept");
  EXPECT_EQ(some.at("poses_kept").get<int>() + some.at("poses_retired").get<int>(), none.at("poses_kept"));
  EXPECT_NE(outcome.out.find(some.at("poses_retired").dump() + " pose"), std::string::npos) << outcome.out;
  const std::string decisions = Read("some/decisions.jsonl");
  const auto last = nlohmann::json::parse(decisions.substr(decisions.rfind('\n', decisions.size() - 2) + 1));
  EXPECT_EQ(last.at("retired_at_end").size(), some.at("poses_retired"));
}

// All that has a row per pose is of the poses remembered, and fits together: the report reads it.
TEST_F(KittiCommandTest, RemembersAsManyFramesAsAskedFor) {
  WriteThresholds(1, 2);
  const std::string run = "kitti rounds --thresholds cheap.json --ground-truth rounds.txt --output ";
  Succeed(run + "all --quiet");
  Succeed(run + "few --quiet --remember all");
  EXPECT_EQ(Read("few/trajectory.kitti.txt"), Read("all/trajectory.kitti.txt")) << "the default";
  const Outcome outcome = Succeed(run + "few --remember 3");
  EXPECT_NE(outcome.out.find(" frames are forgotten (--remember)"), std::string::npos) << outcome.out;
  const auto all = JsonFile("all/stats.json"), few = JsonFile("few/stats.json");
  EXPECT_FALSE(all.contains("frames_forgotten"));
  const auto forgotten = few.at("frames_forgotten").get<std::size_t>();
  EXPECT_GT(forgotten, kFramesOfRounds / 2u);
  EXPECT_EQ(few.at("frames"), kFramesOfRounds);
  EXPECT_EQ(few.at("poses_kept"), all.at("poses_kept"));
  const std::size_t remembered = kFramesOfRounds - forgotten;
  const Trajectory tum = ReadTrajectory(Path("few/trajectory.tum")), whole = ReadTrajectory(Path("all/trajectory.tum"));
  ASSERT_EQ(tum.stamps.size(), remembered);
  for (std::size_t k = 0; k < remembered; ++k) {
    const auto frame = static_cast<std::size_t>(10 * tum.stamps[k] + 0.5);
    EXPECT_LT(tum.T_world_body[k].Local(whole.T_world_body[frame]).norm(), 0.05) << frame;
  }
  EXPECT_EQ(ReadTrajectory(Path("few/ground_truth.tum")).stamps, tum.stamps);
  EXPECT_EQ(JsonFile("few/graph.json").at("poses").size(), remembered);
  EXPECT_EQ(JsonFile("few/graph.json").at("forgotten"), forgotten);
  for (const char* file : {"decisions.csv", "steps.csv"}) {
    EXPECT_EQ(CsvRows(Read(std::string("few/") + file)).size(), remembered) << file;
  }
  for (const char* file : {"trajectory.kitti.txt", "odometry.kitti.txt"}) {
    EXPECT_TRUE(Exists(std::string("all/") + file));
    EXPECT_FALSE(Exists(std::string("few/") + file)) << "rows that are frames by their place alone";
  }
  EXPECT_NEAR(few.at("errors").at("ate_m").get<double>(), all.at("errors").at("ate_m").get<double>(), 0.05);
  EXPECT_TRUE(Exists("few/report.html"));
  for (const std::string bad : {"0", "-1", "some"}) {
    ExpectFailure("kitti street --output bad --remember " + bad, 2, bad + " is neither a number of poses");
  }
}

TEST_F(KittiCommandTest, ChoosesFramesAndSearch) {
  EXPECT_EQ(Succeed("kitti street --output part --frames 2:6 --ground-truth truth.txt --quiet").out, "");
  EXPECT_EQ(JsonFile("part/stats.json").at("frames"), 4);
  EXPECT_EQ(JsonFile("part/stats.json").at("strategy"), "bounded") << "unless another is asked for";
  EXPECT_EQ(ReadTrajectory(Path("part/trajectory.kitti.txt")).T_world_body.size(), 4u);
  EXPECT_NEAR(ReadTrajectory(Path("part/trajectory.tum")).stamps.front(), 0.2, 1e-6);
  const Outcome both = Succeed("kitti street --output both --candidates both");
  EXPECT_NE(both.out.find("appearance"), std::string::npos) << both.out;
  EXPECT_EQ(JsonFile("both/appearance/stats.json").at("poses_kept"), kFrames);
}

// The second half of the lap looks like the first, and by these thresholds all of it is in range.
TEST_F(KittiCommandTest, LeavesOutPlacesThatLookAlike) {
  Succeed("generate stereo --twins --laps 1 --frames 180 --size 306x92 --output twins --quiet");
  Succeed("kitti twins --frames 0:1 --output defaults --quiet");
  auto thresholds = JsonFile("defaults/thresholds.json");
  thresholds["range"] = {200, 200, 200, 3.2};
  Write("wide.json", thresholds.dump());
  const Outcome outcome =
      Succeed("kitti twins --thresholds wide.json --step-budget-ms 0 --ground-truth twins/poses.txt --output map");
  EXPECT_NE(outcome.err.find("all were judged together, and the map is made without the "), std::string::npos)
      << outcome.err;
  const auto stats = JsonFile("map/stats.json");
  const auto& judged = stats.at("loops_judged");
  EXPECT_EQ(judged.at("loops"), stats.at("verified"));
  EXPECT_GT(judged.at("left_out"), 5);
  EXPECT_EQ(judged.at("left_out"), judged.at("links").size());
  EXPECT_LE(stats.at("accepted").get<int>(), judged.at("loops").get<int>() - judged.at("left_out").get<int>());
  EXPECT_LE(stats.at("errors").at("ate_m").get<double>(), 2 * stats.at("odometry_errors").at("ate_m").get<double>());
  EXPECT_EQ(CsvRows(Read("map/decisions.csv")).size(), 180u);
  EXPECT_EQ(CsvRows(Read("map/steps.csv")).size(), 180u);
}

TEST_F(KittiCommandTest, CovariancesByMonteCarlo) {
  Succeed("kitti street --output schur --strategy apfl --frames 0:4 --quiet");
  Succeed("kitti street --output sampled --strategy apfl --frames 0:4 --covariance monte-carlo --quiet");
  EXPECT_EQ(JsonFile("schur/stats.json").at("covariance"), "schur");
  EXPECT_EQ(JsonFile("sampled/stats.json").at("covariance"), "monte-carlo");
  EXPECT_EQ(Read("schur/odometry.kitti.txt"), Read("sampled/odometry.kitti.txt")) << "the motions are the same";
  EXPECT_NE(Read("schur/covariances.csv"), Read("sampled/covariances.csv"));
  ExpectFailure("kitti street --output out --covariance sampled", 2, "sampled");
}

TEST_F(KittiCommandTest, ErrorsNameTheCause) {
  ExpectFailure("kitti nowhere --output out", 1, "nowhere");
  ExpectFailure("kitti street --output out --frames 5:20", 1, "5:20");
  ExpectFailure("kitti street --output out --frames 5", 2, "no range");
  ExpectFailure("kitti street --output out --frames 5:5", 2, "no range");
  ExpectFailure("kitti street --output out --strategy rfpfl", 2, "rfpfl");
  ExpectFailure("kitti street --output out --ground-truth missing.txt", 1, "missing.txt");
  ExpectFailure("kitti street --output out --thresholds missing.json", 1, "missing.json");
  Write("file", "");
  ExpectFailure("kitti street --output file", 1, "in the way");
  Write("two.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1 1\n");
  ExpectFailure("kitti street --output out --ground-truth two.txt", 1, "no pose for frame 2");
  Write("street/image_1/000003.png", "no image");
  ExpectFailure("kitti street --output broken --quiet", 1, "000003.png");
  EXPECT_FALSE(Exists("broken/loops.csv")) << "nothing half done stays";
}

}  // namespace
}  // namespace terse::testing
