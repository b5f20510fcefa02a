// A robot on `terse online` that receives the maps of others: they become part of its own when links agree.

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "testing_command.h"

namespace {

using nlohmann::json;

class OnlineMaps : public terse::testing::CommandTest {
 protected:
  struct Measured {
    std::string line;
    bool is_wrong = false;
  };

  void Generate(int robots, const std::string& options = "--seed 7 --poses 400 --outliers 20") {
    Succeed("generate manhattan --outliers-list wrong.csv --output team --robots " + std::to_string(robots) + ' ' +
            options);
    for (int k = 1; k <= robots; ++k) {
      const std::string name(1, static_cast<char>('a' + k - 1));
      Succeed("compact team/robot_" + std::to_string(k) + ".g2o --retire-share 0 --output " + name + " --quiet");
    }
    std::set<std::vector<std::string>> wrong;
    for (const auto& row : terse::testing::CsvRows(Read("wrong.csv"))) wrong.insert(row);
    std::istringstream file(Read("team/links.txt"));
    for (std::string line; std::getline(file, line);) {
      std::istringstream words(line);
      std::string tag, numbers;
      std::pair<int, long> ends[2];
      words >> tag;
      for (auto& [map, id] : ends) {
        char colon = 0;
        words >> map >> colon >> id;
      }
      std::getline(words, numbers);
      const auto text = [](int number) { return std::to_string(number); };
      const bool is_wrong = wrong.count({text(ends[0].first), std::to_string(ends[0].second), text(ends[1].first),
                                         std::to_string(ends[1].second)}) != 0;
      std::string of_line = tag;
      long when = 0;  // the first robot's pose that it comes with
      for (const auto& [map, id] : ends) {
        of_line += map == 1 ? ' ' + std::to_string(id)
                            : ' ' + std::string(1, static_cast<char>('a' + map - 1)) + ':' + std::to_string(id);
        if (map == 1) when = id;
      }
      links_[when].push_back({of_line + numbers, is_wrong});
      ++(is_wrong ? wrong_ : right_);
    }
  }
  // The first robot's measurements as it makes them, links behind those of their pose, from pose `first` on.
  std::vector<std::string> Stream(bool with_links = true) const {
    std::map<long, std::string> by_pose;
    std::istringstream file(Read("team/robot_1.g2o"));
    for (std::string line; std::getline(file, line);) {
      std::istringstream words(line);
      std::string tag;
      long from = 0, to = 0;
      words >> tag >> from >> to;
      if (tag != "EDGE_SE2") continue;
      std::string& text = by_pose[std::max(from, to)];
      const bool is_odometry = std::abs(from - to) == 1;
      text = is_odometry ? line + '\n' + text : text + line + '\n';
    }
    std::vector<std::string> lines;
    for (const auto& [pose, text] : by_pose) {
      std::istringstream of_pose(text);
      for (std::string line; std::getline(of_pose, line);) lines.push_back(line);
      const auto links = links_.find(pose);
      if (!with_links || links == links_.end()) continue;
      for (const Measured& link : links->second) lines.push_back(link.line);
    }
    return lines;
  }
  std::vector<std::string> Links() const {
    std::vector<std::string> lines;
    for (const auto& [pose, links] : links_) {
      for (const Measured& link : links) lines.push_back(link.line);
    }
    return lines;
  }
  // "240 b:17" of the wrong ones.
  std::set<std::string> WrongEnds() const {
    std::set<std::string> ends;
    for (const auto& [pose, links] : links_) {
      for (const Measured& link : links) {
        std::istringstream words(link.line);
        std::string tag, from, to;
        words >> tag >> from >> to;
        if (link.is_wrong) ends.insert(from + ' ' + to);
      }
    }
    return ends;
  }
  static std::string Text(const std::vector<std::string>& lines) {
    std::string out;
    for (const std::string& line : lines) out += line + '\n';
    return out;
  }
  std::vector<json> Answers(const std::string& input, const std::string& options = "") const {
    Write("input", input);
    std::vector<json> out;
    std::istringstream lines(Succeed(Online() + options + " < input").out);
    for (std::string line; std::getline(lines, line);) {
      out.push_back(json::parse(line));
      out.back().erase("seconds");
    }
    return out;
  }
  static std::vector<json> OfMap(const std::vector<json>& answers, const std::string& name) {
    std::vector<json> out;
    for (const json& answer : answers) {
      if (answer.value("map", "") == name) out.push_back(answer);
    }
    return out;
  }
  // ATE of the run, and of another robot whose ids are moved.
  double Error(const std::string& trajectory, long offset) const {
    std::string truth;
    std::istringstream second(Read("team/robot_2.tum"));
    for (std::string line; std::getline(second, line);) {
      if (line.empty() || line[0] == '#') continue;
      const std::size_t space = line.find(' ');
      truth += std::to_string(std::stol(line.substr(0, space)) + offset) + line.substr(space) + "\n";
    }
    const std::string first = Read("team/robot_1.tum");
    Write("truth.tum", offset < 0 ? truth + first : first + truth);
    return Json("evaluate " + trajectory + " truth.tum --json")["ate"]["translation_m"].get<double>();
  }

  std::string Online() const { return "online --thresholds " + thresholds_of_ + "/thresholds.json "; }

  std::string thresholds_of_ = "a";
  std::map<long, std::vector<Measured>> links_;
  std::size_t right_ = 0, wrong_ = 0;
};

TEST_F(OnlineMaps, BecomePartOfTheRunsAndItGoesOn) {
  Generate(2);
  ASSERT_GT(right_, 10u);
  ASSERT_GT(wrong_, 2u);
  const auto answers = Answers("MAP b b\n" + Text(Stream()), "--output out");
  const auto of_b = OfMap(answers, "b");
  ASSERT_GE(of_b.size(), 2u);
  EXPECT_EQ(of_b.front(), json({{"map", "b"},
                                {"joined", false},
                                {"id_offset", -1000},
                                {"poses", 400},
                                {"poses_kept", of_b.front()["poses_kept"]}}));
  const json& joined = of_b.back();
  EXPECT_TRUE(joined["joined"]);
  EXPECT_GE(joined["links_accepted"], 5);
  EXPECT_EQ(joined["links"].get<int>(), joined["links_accepted"].get<int>() + joined["links_inconsistent"].get<int>());
  const std::set<std::string> wrong = WrongEnds();
  for (const json& ends : joined["inconsistent"])
    EXPECT_EQ(wrong.count(ends[0].get<std::string>() + ' ' + ends[1].get<std::string>()), 1u) << ends;
  // Long before the end: links that come later are tested like any other. None of the wrong ones is in the map.
  long poses_after = 0, links_after = 0;
  bool is_after = false;
  for (const json& answer : answers) {
    is_after = is_after || answer == joined;
    EXPECT_FALSE(answer.contains("error")) << answer;
    if (!is_after || !answer.contains("pose")) continue;
    ++poses_after;
    for (const json& link : answer["links"]) links_after += link["to"].get<long>() < 0 && link["accepted"].get<bool>();
  }
  EXPECT_GT(poses_after, 100);
  EXPECT_GT(links_after, 0);
  EXPECT_LT(Error("out/trajectory.tum", -1000), 0.3);
}

// With all links at once it is the map that `merge` makes of the same two.
TEST_F(OnlineMaps, AreMergedAsMergeDoesIt) {
  Generate(2);
  const std::string all = std::to_string(right_);
  const auto answers = Answers(Text(Stream(false)) + "FLUSH\nMAP b b/graph.json\n" + Text(Links()),
                               "--retire-share 0 --remember all --agreeing-links " + all);
  const auto of_b = OfMap(answers, "b");
  for (std::size_t k = 0; k + 1 < of_b.size(); ++k) EXPECT_FALSE(of_b[k]["joined"]);
  const json joined = of_b.back();
  ASSERT_TRUE(joined["joined"]) << joined;
  const json stats = Json("merge a b --no-retire --links team/links.txt --output joint --json");
  EXPECT_EQ(joined["links_accepted"], right_);
  EXPECT_EQ(stats["links_accepted"], right_);
  EXPECT_EQ(joined["poses_kept"], stats["poses_kept"]);
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_NEAR(joined["T_run_map"][k].get<double>(), stats["maps"][1]["T_joint_map"][k].get<double>(), 1e-6);
    EXPECT_NEAR(joined["sigma_of_first_pose"][k].get<double>(),
                stats["maps"][1]["sigma_of_first_pose"][k].get<double>(), 1e-6);
  }
}

// A map that no link joins to the run comes with the one that it has links to.
TEST_F(OnlineMaps, WaitForEachOther) {
  Generate(3);
  std::vector<std::string> lines = {"MAP c c", "MAP b b"};
  for (const Measured& link : links_.at(0)) {
    if (link.line.find("b:") != std::string::npos && link.line.find("c:") != std::string::npos)
      lines.push_back(link.line);
  }
  ASSERT_GT(lines.size(), 2u + 5u);
  for (const std::string& line : Stream()) {
    if (line.find("c:") == std::string::npos) lines.push_back(line);
  }
  const auto answers = Answers(Text(lines));
  const auto of_b = OfMap(answers, "b"), of_c = OfMap(answers, "c");
  EXPECT_TRUE(of_b.back()["joined"]);
  EXPECT_TRUE(of_c.back()["joined"]);
  EXPECT_EQ(of_c.front()["id_offset"], -1000);
  EXPECT_EQ(of_b.front()["id_offset"], -2000);
}

// Five wrong links in a row agree with each other, and nothing contradicts them yet.
TEST_F(OnlineMaps, AreNotTakenOnLinksOfOnePlace) {
  Generate(2, "--seed 3 --poses 600 --outliers 50 --outlier-kind grouped");
  const auto answers = Answers("MAP b b\n" + Text(Stream()), "--output out");
  const auto of_b = OfMap(answers, "b");
  EXPECT_TRUE(std::any_of(of_b.begin(), of_b.end(), [](const json& answer) {
    return answer.value("cause", "") == "5 links agree, 5 have to (--agreeing-links), of more than one place";
  }));
  ASSERT_TRUE(of_b.back()["joined"]);
  EXPECT_GE(of_b.back()["links_inconsistent"], 5);
  EXPECT_LT(Error("out/trajectory.tum", -1000), 0.3);
  EXPECT_TRUE(OfMap(Answers("MAP b b\n"), "b").size() == 1);
  EXPECT_NE(Read(".err").find("the map b still waits"), std::string::npos);
}

// Killed anywhere and started again it is the same run, with or without a snapshot, and without the folder that the map
// came from.
TEST_F(OnlineMaps, SurviveInTheJournal) {
  Generate(2);
  std::vector<std::string> lines = Stream();
  lines.insert(lines.begin(), "MAP b b");
  // Where a pose is opened: what the one before it measured is all there.
  const auto cut = [&](std::size_t at) {
    for (;; ++at) {
      std::istringstream words(lines[at]);
      std::string tag;
      long from = 0, to = 0;
      if (words >> tag >> from >> to && std::abs(from - to) == 1) return at;
    }
  };
  const auto expected = Answers(Text(lines));
  std::size_t received = 0, joined = 0;
  for (std::size_t k = 0; k < expected.size(); ++k) {
    if (expected[k].value("map", "") != "b") continue;
    (expected[k]["joined"].get<bool>() ? joined : received) = k;
  }
  ASSERT_GT(joined, received);
  std::filesystem::rename(Path("b"), Path("b_away"));
  for (const std::string size : {"64", "0.001"}) {
    std::filesystem::rename(Path("b_away"), Path("b"));
    const std::string journal = "--journal journal" + size + " --journal-size " + size;
    std::vector<json> told;
    std::size_t sent = 0;
    for (const std::size_t until : {cut(30), cut(100), cut(200), lines.size()}) {
      const std::vector<std::string> part(lines.begin() + static_cast<long>(sent),
                                          lines.begin() + static_cast<long>(until));
      const auto answers = Answers(Text(part), journal);
      if (sent > 0) {
        EXPECT_EQ(answers.front()["lines"], sent);
      } else {
        std::filesystem::rename(Path("b"), Path("b_away"));
        const bool has_snapshot = Read("journal" + size).find("\"joined\":false") != std::string::npos;
        EXPECT_EQ(has_snapshot, size != "64");
      }
      told.insert(told.end(), answers.begin() + (sent > 0 ? 1 : 0), answers.end());
      sent = until;
    }
    EXPECT_EQ(told.back(), expected.back()) << size;
    EXPECT_EQ(OfMap(told, "b").back(), OfMap(expected, "b").back()) << size;
  }
  Write("journal64.map-b", Read("b_away/graph.json") + " ");
  Write("input", "");
  ExpectFailure(Online() + "--journal journal64 < input", 1, "journal64.map-b: not the map that the journal");
}

TEST_F(OnlineMaps, DroppedPosesAreForgottenAsBefore) {
  Generate(2);
  const std::string input = "MAP b b\n" + Text(Stream()) + "FLUSH\n";
  std::string questions;
  for (int id = 1; id < 200; ++id) questions += "COVARIANCE " + std::to_string(id) + '\n';
  std::vector<std::string> forgotten;
  for (const json& answer : Answers(input + questions, "--remember 20")) {
    const std::string error = answer.value("error", "");
    const std::size_t at = error.find("pose "), end = error.find(" is forgotten");
    if (end != std::string::npos) forgotten.push_back(error.substr(at + 5, end - at - 5));
  }
  ASSERT_GT(forgotten.size(), 50u);
  const auto answers = Answers(input + "EDGE_SE2 " + forgotten[0] + " b:10 1 0 0 1 0 0 1 0 1\n", "--remember 20");
  ASSERT_TRUE(OfMap(answers, "b").back()["joined"]);
  EXPECT_TRUE(answers.back().value("forgotten", false)) << answers.back();
}

// Where both know their place in the world no links are needed, here and in `merge`.
TEST_F(OnlineMaps, AreJoinedByGnss) {
  Generate(2);
  std::string priors[2];
  for (const int robot : {1, 2}) {
    std::istringstream truth(Read("team/robot_" + std::to_string(robot) + ".tum"));
    double stamp = 0, x = 0, y = 0;
    std::string rest;
    while (truth >> stamp >> x >> y && std::getline(truth, rest)) {
      const long id = std::lround(stamp);
      if (id % 50 != 10) continue;
      priors[robot - 1] += "EDGE_PRIOR_SE2_XY " + std::to_string(id) + ' ' + std::to_string(x) + ' ' +
                           std::to_string(y) + " 100 0 100\n";
    }
    const std::string name = "gnss_" + std::to_string(robot);
    Write(name + ".g2o", Read("team/robot_" + std::to_string(robot) + ".g2o") + priors[robot - 1]);
    Succeed("compact " + name + ".g2o --retire-share 0 --output " + name + " --quiet");
  }
  const json stats = Json("merge gnss_1 gnss_2 --output joint --json");
  for (const json& map : stats["maps"]) {
    EXPECT_EQ(map["placement"], "datum");
    EXPECT_LT(map["sigma_of_first_pose"][0], 0.2);
  }
  EXPECT_LT(Error("joint/trajectory.tum", 1000), 0.3);
  thresholds_of_ = "gnss_1";
  const auto answers = Answers(Text(Stream(false)) + "FLUSH\n" + priors[0] + "MAP b gnss_2\n", "--output out");
  const auto of_b = OfMap(answers, "b");
  ASSERT_EQ(of_b.size(), 2u);
  EXPECT_TRUE(of_b.back()["joined"]);
  EXPECT_EQ(of_b.back()["placement"], "datum");
  EXPECT_LT(Error("out/trajectory.tum", -1000), 0.3);
}

TEST_F(OnlineMaps, BadLinesChangeNothing) {
  Generate(2);
  Succeed("generate sphere --poses 60 --output sphere.g2o");
  Succeed("compact sphere.g2o --output sphere --quiet");
  Write("broken.json", "{\"poses\": 3}");
  std::vector<std::string> lines = Stream();
  lines.insert(lines.begin(), "MAP b b");
  const auto expected = Answers(Text(lines));
  const std::string numbers = " 0 0 0 1 0 0 1 0 1\n";
  const std::vector<std::pair<std::string, std::string>> bad = {
      {"MAP\n", "expected MAP NAME PATH"},
      {"MAP c\n", "expected MAP NAME PATH"},
      {"MAP b a\n", "there is a map b already"},
      {"MAP c:d a\n", "expected a name of letters"},
      {"MAP c nowhere\n", "nowhere: the file does not exist"},
      {"MAP c broken.json\n", "broken.json"},
      {"MAP c sphere\n", "of another dimension, expected 2D"},
      {"RECEIVED c 17\n", "RECEIVED"},
      {"EDGE_SE2 c:3 1" + numbers, "there is no map \"c\""},
      {"EDGE_SE2 b:400 1" + numbers, "no pose 400"},
      {"EDGE_SE2 b:x 1" + numbers, "\"b:x\" is no pose"},
      {"EDGE_SE2 b:3 9999" + numbers, "pose 9999 is unknown"},
      {"EDGE_SE2 b:3 1 0 0 0 1 0 0 -1 0 1\n", "edge b:3 -> 1: the information is not positive definite"},
      {"VERTEX_SE2 b:3 1 0 0\n", "expected EDGE_SE2"}};
  for (const std::string journal : {"", "--journal journal"}) {
    std::string input;
    for (std::size_t k = 0; k < lines.size(); ++k) {
      input += lines[k] + '\n';
      if (k >= 1) input += bad[k % bad.size()].first;
    }
    std::vector<json> good;
    long number = 1;
    for (const json& answer : Answers(input, journal)) {
      if (!answer.contains("error")) good.push_back(answer);
      number += answer.contains("error");
    }
    EXPECT_EQ(number, static_cast<long>(lines.size()));
    EXPECT_EQ(good, expected);
  }
  EXPECT_FALSE(Exists("journal.map-c"));
  for (const auto& [line, cause] : bad) {
    const json answer = Answers("MAP b b\n" + lines[1] + '\n' + line).at(2);
    EXPECT_NE(answer.value("error", "").find(cause), std::string::npos) << answer;
  }
  EXPECT_NE(Run(Online() + "--agreeing-links 1 < input").exit_code, 0);
}

}  // namespace
