// `terse merge` and `terse generate --robots` as a user runs them.

#include <gtest/gtest.h>

#include <algorithm>
#include <sstream>

#include "terse/core/graph_file.h"
#include "testing_command.h"

namespace terse {
namespace {

class MergeCommand : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate manhattan --robots 2 --poses 600 --seed 7 --outliers 20 --outliers-list wrong.csv --output team");
  }
  PoseGraph<SE2> Graph(const std::string& name) const { return std::get<PoseGraph<SE2>>(ReadGraph(Path(name)).graph); }
  static std::size_t Lines(const std::string& svg) {
    std::size_t lines = 0;
    for (std::size_t at = svg.find("<polyline"); at != std::string::npos; at = svg.find("<polyline", at + 1)) ++lines;
    return lines;
  }
  void ExpectRefused(const std::string& links, const std::string& cause) const {
    Write("bad.txt", links);
    ExpectFailure("merge team/robot_1.g2o team/robot_2.g2o --links bad.txt --output out", 1, cause);
  }
};

TEST_F(MergeCommand, JoinsGraphsAndSaysWhichLinksAreWrong) {
  const auto printed =
      Json("merge team/robot_1.g2o team/robot_2.g2o --links team/links.txt --output joint --no-retire --json");
  EXPECT_EQ(printed, JsonFile("joint/stats.json"));
  const auto wrong = testing::CsvRows(Read("wrong.csv")), links = testing::CsvRows(Read("joint/links.csv"));
  EXPECT_EQ(printed["links"], links.size());
  EXPECT_EQ(printed["links_inconsistent"], wrong.size());
  for (const auto& row : links) {
    const std::vector<std::string> ends(row.begin(), row.begin() + 4);
    const bool is_wrong = std::find(wrong.begin(), wrong.end(), ends) != wrong.end();
    EXPECT_EQ(row.at(4), is_wrong ? "inconsistent" : "accepted") << row.at(1) << " " << row.at(3);
  }
  const auto& maps = printed["maps"];
  EXPECT_EQ(maps[0]["placement"], "reference");
  EXPECT_EQ(maps[1]["placement"], "links");
  EXPECT_EQ(maps[1]["id_offset"], 1000);
  const PoseGraph<SE2> joint = Graph("joint/compact.g2o");
  EXPECT_EQ(joint.Poses().size(), 1200u);
  EXPECT_TRUE(joint.HasPose({599}) && joint.HasPose({1599}));
  const std::string report = Read("joint/report.html");
  EXPECT_NE(report.find("<svg"), std::string::npos);
  EXPECT_EQ(Lines(report), 4u) << "each robot's trajectory is one, in the joint map and alone";

  // The truth is of one world: both robots lie in it as one.
  std::string truth = Read("team/robot_1.tum");
  std::istringstream second(Read("team/robot_2.tum"));
  for (std::string line; std::getline(second, line);) {
    if (line.empty() || line[0] == '#') continue;
    const std::size_t space = line.find(' ');
    truth += std::to_string(std::stol(line.substr(0, space)) + 1000) + line.substr(space) + "\n";
  }
  Write("truth.tum", truth);
  const auto errors = Json("evaluate joint/trajectory.tum truth.tum --json");
  EXPECT_LT(errors["ate"]["translation_m"], 0.2) << errors.dump();
}

TEST_F(MergeCommand, ARobotGoesOnInTheJointMap) {
  const PoseGraph<SE2> whole = Graph("team/robot_1.g2o");
  PoseGraph<SE2> first;
  for (const auto& node : whole.Poses()) {
    if (node.id.value < 400) first.AddPose(node.id, node.T_world_body);
  }
  for (const auto& node : whole.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (ends.first.value < 400 && ends.second.value < 400) first.AddFactor(node.factor);
  }
  WriteG2o(first, Path("first.g2o"));
  std::istringstream all(Read("team/links.txt"));
  std::string links;
  for (std::string line; std::getline(all, line);) {
    if (std::stol(line.substr(line.find("1:") + 2)) < 400) links += line + "\n";
  }
  Write("links.txt", links);
  Succeed("compact first.g2o --output a --quiet");
  Succeed("compact team/robot_2.g2o --output b --quiet");
  const auto stats = Json("merge a b --links links.txt --output joint --json");
  EXPECT_EQ(stats["poses"], 1000);
  EXPECT_LT(stats["poses_kept"], stats["poses_kept_before"]);
  Succeed("compact team/robot_1.g2o --continue joint --output on --quiet");
  const auto map = JsonFile("on/graph.json");
  EXPECT_EQ(map["poses"].size(), 1200u);
  EXPECT_EQ(map["poses"].back()["id"], 599);
  Succeed("plot on --what trajectory --output pictures");
  EXPECT_EQ(Lines(Read("pictures/trajectory.svg")), 2u);
  Succeed("plot b --what trajectory --output pictures");
  EXPECT_EQ(Lines(Read("pictures/trajectory.svg")), 1u);
}

TEST_F(MergeCommand, SaysWhatIsWrongWithWhatItIsGiven) {
  ExpectFailure("merge team/robot_1.g2o --output out", 2, "two maps or more");
  ExpectFailure("merge team/robot_1.g2o missing.g2o --output out", 1, "missing.g2o");
  ExpectFailure("merge team/robot_1.g2o team/robot_2.g2o --output out", 3, "nothing holds the maps together");
  Succeed("generate sphere --poses 20 --output sphere.g2o");
  ExpectFailure("merge team/robot_1.g2o sphere.g2o --output out", 1, "sphere.g2o: 3D");
  const std::string numbers = " 0 0 0 1 0 0 1 0 1\n";
  ExpectRefused("EDGE_SE2 1:3 3:4" + numbers, "bad.txt:1: there is no map 3");
  ExpectRefused("# a comment\nEDGE_SE2 3 4" + numbers, "bad.txt:2: several maps have a pose 3");
  ExpectRefused("EDGE_SE2 1:3 2:600" + numbers, "bad.txt:1: map 2 (robot_2) has no pose 600");
  ExpectRefused("EDGE_SE2 1:3 1:4" + numbers, "both poses are of map 1");
  ExpectRefused("EDGE_SE2 1:3 2:x" + numbers, "\"2:x\" is no pose");
  ExpectRefused("EDGE_SE2 1:3 2:4 0 0 0 1 0 0 1 0\n", "takes 11 fields");
  ExpectRefused("EDGE_SE2 1:3 2:4 0 0 0 1 0 0 -1 0 1\n", "edge 1:3 -> 2:4: the information is not positive definite");
  ExpectRefused("VERTEX_SE2 1:3 0 0 0\n", "expected EDGE_SE2");
  EXPECT_FALSE(Exists("out/stats.json"));
  ExpectFailure("generate sphere --robots 2 --output y", 2, "manhattan");
  ExpectFailure("generate manhattan --robots 2", 2, "--output");
  ExpectFailure("generate manhattan --robots 2 --outliers 10 --outlier-kind local --output y", 2, "random or grouped");
}

}  // namespace
}  // namespace terse
