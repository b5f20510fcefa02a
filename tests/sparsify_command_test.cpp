// `terse sparsify` and `terse table sparsify` as a user runs them.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <filesystem>
#include <map>
#include <sstream>

#include "terse/core/graph_file.h"
#include "testing_command.h"

namespace terse {
namespace {

class SparsifyCommand : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate manhattan --poses 200 --seed 4 --output walk.g2o");
  }
  PoseGraph<SE2> Graph(const std::string& name) const { return std::get<PoseGraph<SE2>>(ReadGraph(Path(name)).graph); }
};

TEST_F(SparsifyCommand, KeepsWhatIsAskedForUnderTheIdsThatItHad) {
  Succeed("sparsify walk.g2o --links 20% --poses 50% --output small");
  const auto stats = JsonFile("small/stats.json");
  const PoseGraph<SE2> whole = Graph("walk.g2o"), small = Graph("small/compact.g2o");
  EXPECT_EQ(stats["poses"], 200);
  EXPECT_EQ(stats["poses_kept"], 100);
  EXPECT_EQ(stats["links_kept"], std::lround(0.2 * stats["links"].get<double>()));
  EXPECT_LT(stats["expected_error_whole_m"], stats["expected_error_m"]);
  EXPECT_GE(stats["divergence_nats"], 0);
  EXPECT_EQ(small.Poses().size(), 100u);
  EXPECT_EQ(small.Factors().size(), stats["factors_kept"]);
  for (const auto& node : small.Poses()) EXPECT_TRUE(whole.HasPose(node.id));

  const auto links = testing::CsvRows(Read("small/links.csv"));
  EXPECT_EQ(links.size(), stats["links"]);
  const auto kept = [](const std::vector<std::string>& row) { return row.at(3) == "1"; };
  EXPECT_EQ(std::count_if(links.begin(), links.end(), kept), stats["links_kept"]);
  const std::string trajectory = Read("small/trajectory.tum"), report = Read("small/report.html");
  EXPECT_EQ(std::count(trajectory.begin(), trajectory.end(), '\n'), 200) << "dropped poses too";
  EXPECT_NE(report.find("<svg"), std::string::npos);
  const auto map = JsonFile("small/graph.json");
  EXPECT_EQ(map["poses"].size(), 200u);
  EXPECT_EQ(
      std::count_if(map["poses"].begin(), map["poses"].end(), [](const auto& pose) { return pose["kept"] == true; }),
      100);
  Succeed("solve small/compact.g2o --output solved.g2o");
}

TEST_F(SparsifyCommand, TheResultDoesNotDependOnThreadsAndJsonIsWhatTheFileHolds) {
  const auto printed = Json("sparsify walk.g2o --links 40 --output one --json");
  EXPECT_EQ(printed, JsonFile("one/stats.json"));
  EXPECT_EQ(printed["links_kept"], 40);
  Succeed("sparsify walk.g2o --links 40 --threads 2 --quiet --output two");
  for (const char* file : {"/compact.g2o", "/links.csv", "/trajectory.tum", "/graph.json"})
    EXPECT_EQ(Read(std::string("one") + file), Read(std::string("two") + file)) << file;
}

TEST_F(SparsifyCommand, ABudgetOfTheErrorIsMetWithAsFewLinksAsItTakes) {
  const auto close = Json("sparsify walk.g2o --budget-error 1.05 --output small --json");
  const auto far = Json("sparsify walk.g2o --budget-error 1.5 --output small --json");
  for (const auto& [stats, factor] : {std::pair(close, 1.05), std::pair(far, 1.5)}) {
    const double whole = stats["expected_error_whole_m"];
    EXPECT_LE(stats["expected_error_m"], factor * whole * (1 + 1e-9));
    const long fewer = stats["links_kept"].get<long>() - 2;
    const auto less = Json("sparsify walk.g2o --links " + std::to_string(fewer) + " --output small --json");
    EXPECT_GT(less["expected_error_m"], 0.98 * factor * whole);
  }
  EXPECT_LT(far["links_kept"], close["links_kept"]);
  EXPECT_LT(close["links_kept"], close["links"]);
}

TEST_F(SparsifyCommand, EveryCriterionLeadsInWhatItIsAbout) {
  std::map<std::string, nlohmann::json> by;
  for (const std::string criterion : {"position", "information", "connectivity", "random"})
    by[criterion] = Json("sparsify walk.g2o --links 15% --output small --json --criterion " + criterion);
  for (const auto& [criterion, stats] : by) {
    EXPECT_EQ(stats["criterion"], criterion);
    EXPECT_LE(by["position"]["expected_error_m"], stats["expected_error_m"]) << criterion;
    EXPECT_LE(by["information"]["log_det_lost_nats"], stats["log_det_lost_nats"]) << criterion;
  }
}

TEST_F(SparsifyCommand, SaysWhatIsWrongAndLosesNothing) {
  ExpectFailure("sparsify walk.g2o --output small", 2, "--links, --poses or --budget-error");
  ExpectFailure("sparsify walk.g2o --links 20%", 2, "--output");
  for (const char* budget : {"120%", "-1", "1.5", "x", "nan", "%"})
    ExpectFailure(std::string("sparsify walk.g2o --output small --links ") + budget, 2, "neither a share as 20%");
  ExpectFailure("sparsify walk.g2o --output small --budget-error 0.9", 2, "--budget-error");
  ExpectFailure("sparsify walk.g2o --output small --links 9 --budget-error 1.1", 2, "excludes");
  ExpectFailure("sparsify walk.g2o --output small --links 9 --criterion postion", 2, "did you mean position?");
  ExpectFailure("sparsify nowhere.g2o --output small --links 9", 1, "nowhere.g2o");
  EXPECT_FALSE(Exists("small"));
  Succeed("sparsify walk.g2o --links 20% --output small");
  const std::string before = Read("small/stats.json");
  Write("broken.g2o", "VERTEX_SE2 0 0 0\n");
  ExpectFailure("sparsify broken.g2o --output small --links 9", 1, "broken.g2o:1");
  EXPECT_EQ(Read("small/stats.json"), before);
}

TEST_F(SparsifyCommand, WarnsWhereTheResidualsContradictTheInformation) {
  EXPECT_EQ(Succeed("sparsify walk.g2o --links 20% --output small").err, "");
  PoseGraph<SE2> unsure;
  const PoseGraph<SE2> walk = Graph("walk.g2o");
  for (const auto& node : walk.Poses()) unsure.AddPose(node.id, node.T_world_body);
  for (const auto& node : walk.Factors()) {
    auto edge = std::get<RelativePoseFactor<SE2>>(node.factor);
    edge.information /= 100;
    unsure.AddFactor(edge);
  }
  WriteG2o(unsure, Path("unsure.g2o"));
  const std::string err = Succeed("sparsify unsure.g2o --links 20% --output small").err;
  double times = 0;
  ASSERT_EQ(std::sscanf(err.c_str(), "terse: warning: residuals are %lf times smaller", &times), 1) << err;
  EXPECT_NEAR(times, 10, 2);
}

TEST_F(SparsifyCommand, AnInterruptLeavesWhatWasThere) {
  Succeed("sparsify walk.g2o --links 20% --output small");
  const std::string before = Read("small/compact.g2o"), stats = Read("small/stats.json");
  Succeed("generate manhattan --poses 6000 --seed 5 --output long.g2o");
  Interrupt({"sparsify", "long.g2o", "--links", "30%", "--output", "small", "--quiet"}, SIGINT,
            testing::After(std::chrono::milliseconds(300)));
  EXPECT_EQ(Read("small/compact.g2o"), before);
  EXPECT_EQ(Read("small/stats.json"), stats);
}

TEST_F(SparsifyCommand, TakesPartsThatDoNotHangTogether) {
  const std::string walk = Read("walk.g2o");
  std::string other;
  std::istringstream lines(walk);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string tag, rest;
    long a = 0, b = 0;
    words >> tag >> a;
    other += tag + ' ' + std::to_string(a + 1000);
    if (tag == "EDGE_SE2") {
      words >> b;
      other += ' ' + std::to_string(b + 1000);
    }
    std::getline(words, rest);
    other += rest + '\n';
  }
  Write("both.g2o", walk + other);
  const auto stats = Json("sparsify both.g2o --links 20% --poses 300 --output small --json");
  EXPECT_EQ(stats["poses_kept"], 300);
  const PoseGraph<SE2> small = std::get<PoseGraph<SE2>>([&] {
    ReadOptions read;
    read.expect_connected = false;
    return ReadGraph(Path("small/compact.g2o"), read).graph;
  }());
  EXPECT_EQ(ConnectedComponents(small).size(), 2u);
}

class SparsifyTable : public SparsifyCommand {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    std::filesystem::create_directory(folder_ / "few");
    Succeed("generate manhattan --poses 80 --seed 6 --output few/walk.g2o");
    Succeed("generate sphere --poses 60 --seed 7 --output few/ball.g2o");
  }
};

TEST_F(SparsifyTable, HoldsEveryCellAndSumsThemUp) {
  const std::string arguments = "table sparsify few --percents 40,20,20 --draws 2 --sparsities 3,2 --quiet --json";
  const auto json = Json(arguments);
  EXPECT_EQ(json["percents"], nlohmann::json({20, 40}));
  EXPECT_EQ(json["sparsities"], nlohmann::json({2, 3}));
  ASSERT_EQ(json["graphs"].size(), 2u);
  int position_best = 0, information_best = 0;
  for (const auto& graph : json["graphs"]) {
    EXPECT_TRUE(graph["failure"].is_null());
    ASSERT_EQ(graph["link_rows"].size(), 8u);
    ASSERT_EQ(graph["pose_rows"].size(), 6u);
    for (int cell = 0; cell < 2; ++cell) {
      const auto row = [&](int k) { return graph["link_rows"][static_cast<std::size_t>(4 * cell + k)]; };
      double least_lost = row(0)["log_det_lost_nats"];
      const std::array<const char*, 4> names = {"position", "information", "connectivity", "random"};
      for (int k = 0; k < 4; ++k) {
        EXPECT_EQ(row(k)["criterion"], names[static_cast<std::size_t>(k)]);
        EXPECT_EQ(row(k)["links"], std::lround(row(k)["percent"].get<double>() / 100 * graph["links"].get<double>()));
        EXPECT_GT(row(k)["ate_m"], 0);
        // A greedy choice may miss the best by a little.
        EXPECT_GE(row(k)["expected_error_m"], 0.99 * row(0)["expected_error_m"].get<double>());
        EXPECT_GE(row(k)["log_det_lost_nats"], 0.995 * row(1)["log_det_lost_nats"].get<double>());
        least_lost = std::min(least_lost, row(k)["log_det_lost_nats"].get<double>());
      }
      position_best += row(0)["ate_m"] <= std::min(row(2)["ate_m"].get<double>(), row(3)["ate_m"].get<double>());
      information_best += row(1)["log_det_lost_nats"] <= least_lost * (1 + 1e-9);
    }
    for (std::size_t k = 0; k < 6; k += 3) {
      const auto divergence = [&](std::size_t j) { return graph["pose_rows"][k + j]["divergence_nats"].get<double>(); };
      EXPECT_GE(divergence(2), -1e-6);
      EXPECT_LE(divergence(1), divergence(0) + 1e-6);
    }
  }
  EXPECT_EQ(json["summary"]["cells"], 4);
  EXPECT_EQ(json["summary"]["position_best"], position_best);
  EXPECT_EQ(json["summary"]["information_best"], information_best);
}

TEST_F(SparsifyTable, GoesOnAfterAGraphThatFailsAndFillsADocument) {
  Write("few/a.g2o", "VERTEX_SE2 0 0 0\n");
  Write("doc.md", "before\n<!-- sparsify -->\nold\n<!-- /sparsify -->\nafter\n");
  const auto outcome =
      Succeed("table sparsify few --graphs a,walk --percents 20 --draws 1 --sparsities 2 --update doc.md");
  EXPECT_NE(outcome.out.find("a: left out, "), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("| position "), std::string::npos) << outcome.out;
  EXPECT_NE(outcome.out.find("of 1 cells"), std::string::npos) << outcome.out;
  const std::string document = Read("doc.md");
  EXPECT_NE(document.find("| subgraph "), std::string::npos);
  EXPECT_EQ(document.find("old"), std::string::npos);
  EXPECT_EQ(document.rfind("before\n", 0), 0u);

  ExpectFailure("table sparsify nowhere", 1, "nowhere: ");
  ExpectFailure("table sparsify few --graphs wlak", 2, "did you mean walk?");
  ExpectFailure("table sparsify few --percents 101", 2, "--percents");
  ExpectFailure("table sparsify few --sparsities 0", 2, "--sparsities");
  ExpectFailure("table sparsify few --criteria postion", 2, "did you mean position?");
  ExpectFailure("table sparsify few --update few/walk.g2o", 2, "few/walk.g2o");
  ExpectFailure("table sparsify few --graphs a --quiet", 1, "a.g2o:1");
}

}  // namespace
}  // namespace terse
