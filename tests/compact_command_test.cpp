// `terse compact` as its users and the tools that call it see it.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <sstream>

#include "terse/compact/graph_replay.h"
#include "terse/core/graph_file.h"
#include "terse/core/trajectory.h"
#include "terse/covariance/marginals.h"
#include "testing_command.h"

namespace terse {
namespace {

using testing::CsvRows;
using testing::Outcome;

class CompactCommand : public testing::CommandTest {
 protected:
  void MakeScene(const std::string& scene) const {
    Succeed("generate " + scene + (scene == "ellipse-n" ? " --poses 255 --laps 3" : " --poses 300") +
            " --output in.g2o");
  }
  template <class Pose>
  PoseGraph<Pose> ReadAs(const std::string& name, RotationInformation reading = {}) const {
    ReadOptions options;
    options.rotation_information = reading;
    return std::get<PoseGraph<Pose>>(ReadGraph(Path(name), options).graph);
  }
};

const std::vector<std::string> kResults = {"compact.g2o", "covariances.csv", "decisions.csv", "stats.json",
                                           "trajectory.tum"};

template <class Pose>
bool HasFactor(const PoseGraph<Pose>& graph, const Factor<Pose>& factor) {
  const auto& a = std::get<RelativePoseFactor<Pose>>(factor);
  for (const auto& node : graph.Factors()) {
    const auto& b = std::get<RelativePoseFactor<Pose>>(node.factor);
    // Written and read again: the last bits of what was concatenated or converted.
    if (a.from == b.from && a.to == b.to && a.T_from_to.Local(b.T_from_to).norm() < 1e-9 &&
        (a.information - b.information).norm() < 1e-9 * b.information.norm()) {
      return true;
    }
  }
  return false;
}

// What all strategies owe: files that agree with each other and with the input.
template <class Pose>
void ExpectConsistent(const std::filesystem::path& folder, const PoseGraph<Pose>& input) {
  const auto read = [&](const char* name) { return testing::Slurp(folder / name); };
  const auto compact = std::get<PoseGraph<Pose>>(ReadGraph((folder / "compact.g2o").string()).graph);
  const auto stats = nlohmann::json::parse(read("stats.json"));
  EXPECT_EQ(stats["poses"], input.Poses().size());
  EXPECT_EQ(stats["edges"], input.Factors().size());
  EXPECT_EQ(stats["poses_kept"], compact.Poses().size());
  EXPECT_EQ(stats["steps"], input.Poses().size());
  const double chi2 = stats["chi2"];
  EXPECT_NEAR(Chi2(compact), chi2, 1e-8 * chi2 + 1e-12);
  EXPECT_EQ(compact.Factors().size(), compact.Poses().size() - 1 + stats.at("links_kept").template get<std::size_t>())
      << "a link to the pose before, and the loops";

  const Trajectory trajectory = ReadTrajectory((folder / "trajectory.tum").string());
  ASSERT_EQ(trajectory.stamps.size(), input.Poses().size());
  std::map<double, SE3> T_world_body;
  for (std::size_t k = 0; k < trajectory.stamps.size(); ++k) {
    T_world_body[trajectory.stamps[k]] = trajectory.T_world_body[k];
  }
  for (const auto& node : input.Poses()) EXPECT_EQ(T_world_body.count(static_cast<double>(node.id.value)), 1u);
  std::vector<Pose> values;
  for (const auto& node : compact.Poses()) {
    EXPECT_TRUE(input.HasPose(node.id));
    values.push_back(*node.T_world_body);
    SE3 lifted;
    if constexpr (Pose::kDim == 2) {
      lifted = Lift(values.back());
    } else {
      lifted = values.back();
    }
    EXPECT_LT(lifted.Local(T_world_body.at(static_cast<double>(node.id.value))).norm(), 1e-9) << node.id.value;
  }

  const auto decisions = CsvRows(read("decisions.csv"));
  ASSERT_EQ(decisions.size(), input.Poses().size());
  long kept = 0, links = 0, tried = 0;
  for (const auto& row : decisions) {
    ASSERT_EQ(row.size(), 11u);
    EXPECT_EQ(compact.HasPose({std::stoll(row[0])}), row[1] == "1") << row[0];
    kept += std::stol(row[1]);
    tried += std::stol(row[4]);
    links += std::stol(row[5]);
  }
  EXPECT_EQ(stats["poses_kept"], kept);
  EXPECT_EQ(stats["links_kept"], links);
  EXPECT_EQ(stats["registrations_tried"], tried);

  const Marginals<Pose> marginals(compact, values);
  const auto rows = CsvRows(read("covariances.csv"));
  ASSERT_EQ(rows.size(), values.size());
  for (const auto& row : rows) {
    ASSERT_EQ(row.size(), 1u + Pose::kDof * Pose::kDof);
    const auto expected = marginals.Marginal({std::stoll(row[0])});
    typename Pose::Jacobian actual;
    for (int i = 0; i < Pose::kDof * Pose::kDof; ++i) {
      actual(i / Pose::kDof, i % Pose::kDof) = std::stod(row[1 + static_cast<std::size_t>(i)]);
    }
    EXPECT_LT((actual - expected).norm(), 1e-6 * expected.norm()) << row[0];
  }
}

TEST_F(CompactCommand, FilesAgreeWithEachOther) {
  const auto check = [&](auto pose, const std::string& scene) {
    using Pose = decltype(pose);
    MakeScene(scene);
    const auto input = ReadAs<Pose>("in.g2o");
    for (const std::string strategy : {"apal", "apfl", "fpfl"}) {
      SCOPED_TRACE(scene + ' ' + strategy);
      const Outcome outcome = Succeed("compact in.g2o --strategy " + strategy + " --output " + strategy);
      EXPECT_EQ(outcome.err, "") << "no progress where standard error is no terminal";
      EXPECT_NE(outcome.out.find("results in " + strategy), std::string::npos) << outcome.out;
      std::vector<std::string> names;
      for (const auto& entry : std::filesystem::directory_iterator(folder_ / strategy)) {
        names.push_back(entry.path().filename().string());
      }
      std::sort(names.begin(), names.end());
      EXPECT_EQ(names, kResults);
      ExpectConsistent<Pose>(folder_ / strategy, input);
      const auto stats = JsonFile(strategy + "/stats.json");
      const GraphReplay<Pose> replay(input);
      EXPECT_EQ(stats["links_offered"], replay.LinksOffered());
      // What is kept as it was given: all links, and odometry between poses that are both kept.
      const auto compact = ReadAs<Pose>(strategy + "/compact.g2o");
      long same = 0;
      for (const auto& node : compact.Factors()) same += HasFactor(input, node.factor);
      EXPECT_GE(same, stats.at("links_kept").template get<long>());
      if (strategy != "fpfl") {
        EXPECT_EQ(same, static_cast<long>(compact.Factors().size()));
        EXPECT_EQ(stats["poses_kept"], stats["poses"]);
      }
      if (strategy == "apal") {
        EXPECT_EQ(stats["links_kept"], stats["links_offered"]);
      }
    }
    const auto kept = [&](const char* what, const std::string& s) {
      return JsonFile(s + "/stats.json")[what].template get<long>();
    };
    EXPECT_LT(kept("poses_kept", "fpfl"), kept("poses_kept", "apal")) << scene;
    EXPECT_LE(kept("links_kept", "apfl"), kept("links_kept", "apal")) << scene;
    std::filesystem::remove_all(folder_ / "fpfl");
  };
  check(SE2(), "manhattan");
  check(SE3(), "ellipse-n");
}

TEST_F(CompactCommand, AllPosesAllLinksIsThePlainProblem) {
  MakeScene("manhattan");
  Succeed("compact in.g2o --strategy apal --output all");
  Succeed("solve in.g2o --stats solved.json");
  const double chi2 = JsonFile("solved.json")["chi2"];
  EXPECT_NEAR(JsonFile("all/stats.json")["chi2"].get<double>(), chi2, 1e-8 * chi2);
  Succeed("solve all/compact.g2o --stats again.json");
  EXPECT_NEAR(JsonFile("again.json")["chi2"].get<double>(), chi2, 1e-8 * chi2) << "what is written can be solved again";
}

TEST_F(CompactCommand, StatisticsHaveTheAgreedKeys) {
  MakeScene("manhattan");
  Succeed("solve in.g2o --stats solved.json");
  Succeed("compact in.g2o --strategy fpfl --output few");
  const auto stats = JsonFile("few/stats.json");
  const auto solved = JsonFile("solved.json");
  for (const auto& item : solved.items()) EXPECT_TRUE(stats.contains(item.key())) << item.key();
  for (const char* key : {"poses_kept", "links_kept", "links_offered", "registrations_tried"}) {
    EXPECT_TRUE(stats[key].is_number_integer()) << key;
  }
  EXPECT_EQ(stats["strategy"], "fpfl");
}

TEST_F(CompactCommand, ThresholdsAreObeyed) {
  MakeScene("manhattan");
  const std::string run = "compact in.g2o --strategy fpfl --output few ";
  Succeed(run + "--range 3 4 1.5 --min-pose-gain 2 --min-loop-gain 1.25 --probability 0.2");
  const auto given = JsonFile("few/stats.json");
  EXPECT_EQ(given["thresholds"],
            nlohmann::json(
                {{"range", {3.0, 4.0, 1.5}}, {"probability", 0.2}, {"min_loop_gain", 1.25}, {"min_pose_gain", 2.0}}));
  for (const auto& row : CsvRows(Read("few/decisions.csv"))) {
    if (row[2] == "redundant") {
      EXPECT_LE(std::stod(row[3]), 2.0) << row[0];
    }
    if (row[2] == "informative") {
      EXPECT_GT(std::stod(row[3]), 2.0) << row[0];
    }
    std::istringstream probabilities(row[7]), measured(row[9]), accepted(row[10]);
    double probability = 0;
    std::string gain, flag;
    while (probabilities >> probability) EXPECT_GT(probability, 0.2) << row[0];
    while (measured >> gain && accepted >> flag) {
      EXPECT_EQ(flag == "1", gain != "-" && std::stod(gain) > 1.25) << row[0];
    }
  }
  // One is given, the others come from the sample and do not depend on it.
  Succeed(run + "--min-loop-gain 0");
  const auto links = JsonFile("few/stats.json");
  Succeed(run);
  const auto chosen = JsonFile("few/stats.json");
  EXPECT_EQ(links["thresholds"]["min_loop_gain"], 0);
  EXPECT_EQ(links["thresholds"]["min_pose_gain"], chosen["thresholds"]["min_pose_gain"]);
  EXPECT_EQ(links["thresholds"]["range"], chosen["thresholds"]["range"]);
  Succeed(run + "--min-pose-gain 1e9 --min-loop-gain 1e9");
  const auto fewest = JsonFile("few/stats.json");
  EXPECT_EQ(fewest["links_kept"], 0);
  EXPECT_LT(fewest["poses_kept"], chosen["poses_kept"]);
}

TEST_F(CompactCommand, RecoveryConcernsDroppedPosesOnly) {
  MakeScene("ellipse-n");
  std::set<std::string> trajectories;
  std::string graph;
  for (const std::string recovery : {"v0", "v1", "v2"}) {
    Succeed("compact in.g2o --strategy fpfl --output few --recover " + recovery);
    EXPECT_LT(JsonFile("few/stats.json")["poses_kept"], 255);
    trajectories.insert(Read("few/trajectory.tum"));
    if (!graph.empty()) {
      EXPECT_EQ(Read("few/compact.g2o"), graph) << "same run, bit by bit";
    }
    graph = Read("few/compact.g2o");
  }
  EXPECT_EQ(trajectories.size(), 3u);
  Succeed("compact in.g2o --strategy fpfl --output few");
  EXPECT_EQ(trajectories.count(Read("few/trajectory.tum")), 1u);
}

TEST_F(CompactCommand, ReadOptionsAndQuiet) {
  MakeScene("ellipse-n");
  const Outcome outcome = Succeed("compact in.g2o --strategy apal --rotation-information radians --output r --quiet");
  EXPECT_EQ(outcome.out + outcome.err, "");
  const double chi2 = JsonFile("r/stats.json")["chi2"];
  EXPECT_NEAR(Chi2(ReadAs<SE3>("r/compact.g2o", RotationInformation::kRadians)), chi2, 1e-8 * chi2)
      << "written as it was read";
  Write("bad.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1\n");
  ExpectFailure("compact bad.g2o --strategy apal --output bad", 1, "bad.g2o:1: ");
  EXPECT_FALSE(Exists("bad"));
  EXPECT_NE(Succeed("compact bad.g2o --strategy apal --output bad --repair-information").err.find("clamped"),
            std::string::npos);
}

TEST_F(CompactCommand, UsageErrorsExitWith2AndLeaveNothing) {
  Write("plane.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("space.g2o", "EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\n");
  const std::string plane = "compact plane.g2o --output out --strategy ", space = "compact space.g2o --output out ";
  ExpectFailure("compact", 2, "required");
  ExpectFailure("compact plane.g2o --output out", 2, "--strategy is required");
  ExpectFailure("compact plane.g2o --strategy apal", 2, "--output is required");
  ExpectFailure(plane + "few", 2, "few");
  ExpectFailure(plane + "fpfl --recover v3", 2, "v3");
  ExpectFailure(plane + "fpfl --range 1 2", 2, "--range");
  ExpectFailure(plane + "fpfl --range 1 2 3 4 5", 2, "At Most 4 required but received 5");
  ExpectFailure(plane + "fpfl --range 1 2 0", 2, "0 is not a positive number");
  ExpectFailure(plane + "fpfl --range 1 2 nan", 2, "nan is not a positive number");
  ExpectFailure(plane + "fpfl --range 1 2 3 4", 2, "4 numbers given, but a 2D graph takes X Y ANGLE");
  ExpectFailure(space + "--strategy fpfl --range 1 2 3", 2, "3 numbers given, but a 3D graph takes X Y Z ANGLE");
  ExpectFailure(plane + "fpfl --range 1 2 x", 2, "x is not a positive number");
  ExpectFailure(plane + "fpfl --probability 1", 2, "--probability");
  ExpectFailure(plane + "fpfl --probability -0.1", 2, "--probability");
  ExpectFailure(plane + "fpfl --min-pose-gain -1", 2, "--min-pose-gain");
  ExpectFailure(plane + "fpfl --min-loop-gain much", 2, "much");
  EXPECT_EQ(FileCount(), 2);
  // FILE may come last.
  Succeed("compact --output out --strategy fpfl --range 1 2 3 plane.g2o");
  Succeed("compact --output out --strategy fpfl --range 1 2 3 1 space.g2o");
}

TEST_F(CompactCommand, BadInputAndOutputExitWith1) {
  Write("in.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n");
  Write("file", "");
  const std::string run = "compact in.g2o --strategy fpfl --output ";
  ExpectFailure("compact missing.g2o --strategy fpfl --output out", 1, "missing.g2o: the file does not exist");
  ExpectFailure("compact . --strategy fpfl --output out", 1, ".: ");
  EXPECT_FALSE(Exists("out"));
  ExpectFailure(run + "file", 1, "file: cannot make this folder: a file of this name is in the way");
  ExpectFailure(run + "file/out", 1, "file/out: cannot make this folder");
  if (std::filesystem::exists("/proc/self")) ExpectFailure(run + "/proc/out", 1, "/proc/out: cannot make this folder");
  if (geteuid() != 0) {  // root may write everywhere
    std::filesystem::create_directory(folder_ / "closed");
    std::filesystem::permissions(folder_ / "closed",
                                 std::filesystem::perms::owner_read | std::filesystem::perms::owner_exec);
    ExpectFailure(run + "closed", 1, "cannot write");
  }
  Succeed(run + "deep/er/out --quiet");
  EXPECT_TRUE(Exists("deep/er/out/stats.json"));
}

// Squares beyond the range of doubles.
TEST_F(CompactCommand, ANumericalFailureExitsWith3) {
  Write("in.g2o", "EDGE_SE2 0 1 1e200 0 0 1 0 0 1 0 1\nEDGE_SE2 0 1 -1e200 0 0 1 0 0 1 0 1\n");
  ExpectFailure("compact in.g2o --output out --strategy apal", 3, "in.g2o: ");
  EXPECT_TRUE(std::filesystem::is_empty(folder_ / "out"));
}

TEST_F(CompactCommand, AnInterruptLeavesNoFile) {
  Succeed("generate garage --poses 3000 --output in.g2o");
  for (const int signal : {SIGINT, SIGTERM}) {
    Interrupt(
        {"compact", "in.g2o", "--strategy", "apal", "--output", "out"}, signal,
        [&, after = testing::After(std::chrono::milliseconds(300))]() mutable { return Exists("out") && after(); });
    EXPECT_TRUE(std::filesystem::is_empty(folder_ / "out"));
  }
}

}  // namespace
}  // namespace terse
