// `terse table igg-spo`: the published figures where the public data is present, and its errors. Builds with sanitizers
// take the slow variants over the first poses only. `terse table compact` and
// `terse table outliers`: on generated graphs.

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "shared_data.h"
#include "testing_command.h"

namespace terse {
namespace {

class TableCommand : public testing::CommandTest {
 protected:
  nlohmann::json Rows(const std::string& folder, const std::string& rest) const {
    return Json("table igg-spo '" + folder + "' --json --quiet " + rest);
  }
  // The folder itself; with sanitizers one with the first 150 poses of that graph.
  std::string FolderForSlowPolicies(const std::string& folder, const std::string& name) const {
    if (!kSlowBuild) return folder;
    std::ifstream in(folder + '/' + name);
    std::string text;
    for (std::string line; std::getline(in, line);) {
      std::istringstream words(line);
      std::string tag;
      long first = 0, second = 0;
      words >> tag >> first;
      if (tag == "EDGE_SE2") words >> second;
      if (first < 150 && second < 150) text += line + '\n';
    }
    Write(name, text);
    return ".";
  }
};

const nlohmann::json& Row(const nlohmann::json& rows, const std::string& policy) {
  for (const auto& row : rows) {
    if (row["policy"] == policy) return row;
  }
  throw std::invalid_argument("no row " + policy);
}

void ExpectWithin(double share, double expected, const nlohmann::json& value, const char* what) {
  EXPECT_NEAR(value.get<double>(), expected, share * expected) << what;
}

TEST_F(TableCommand, SaysWhatIsMissing) {
  ExpectFailure("table", 2, "ubcommand");
  ExpectFailure("table igg-spo", 2, "DIR");
  ExpectFailure("table igg-spo nowhere", 1, "nowhere/MIT.g2o: no such file");
  ExpectFailure("table igg-spo . --graphs MIT,nothing", 2, "nothing");
  ExpectFailure("table igg-spo . --initial tree", 2, "tree");
  Write("MIT.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n");
  ExpectFailure("table igg-spo . --graphs MIT", 1, "a 3D graph, expected a 2D one");
  Write("MIT.g2o", "VERTEX_SE2 0 0 0\n");
  ExpectFailure("table igg-spo . --graphs MIT", 1, "MIT.g2o:1");
}

TEST_F(TableCommand, RunsAnyGraphOfThatName) {
  Succeed("generate manhattan --poses 60 --seed 3 --output MIT.g2o");
  const auto rows = Rows(".", "--graphs MIT");
  ASSERT_EQ(rows.size(), 15u);  // seven from the file's values, seven composed, the default
  for (const auto& row : rows) {
    EXPECT_EQ(row["graph"], "MIT");
    EXPECT_GT(row["normalized_chi2"]["final"], 0);
    EXPECT_GT(row["update_flops"], 0);
    EXPECT_EQ(row["paper_update_flops"].is_null(), row["policy"] == "default");
  }
  const std::string text = Succeed("table igg-spo . --graphs MIT --initial file").out;
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 8) << text;
}

// The figures of the paper's Tables as its published code computes them; of the first poses they are our own.
TEST_F(TableCommand, ReproducesThePaperOnMit) {
  TERSE_NEEDS(folder, "graphs/igg_spo");
  const auto rows = Rows(folder, "--graphs MIT --initial file --policies gni-spo-igg");
  ASSERT_EQ(rows.size(), 1u);
  const auto& spo = Row(rows, "gni-spo-igg");
  ExpectWithin(1e-3, 0.0165918, spo["normalized_chi2"]["final"], "SPO-IGG");
  ExpectWithin(1e-3, 0.0184891, spo["normalized_chi2"]["mean"], "SPO-IGG");
  ExpectWithin(0.01, 66541, spo["paper_update_flops"], "SPO-IGG");
  const auto full = Rows(FolderForSlowPolicies(folder, "MIT.g2o"), "--graphs MIT --initial file --policies gn1,gni");
  ASSERT_EQ(full.size(), 2u);
  const auto& gni = Row(full, "gni");
  ExpectWithin(1e-3, kSlowBuild ? 0.0121298 : 0.0165914, gni["normalized_chi2"]["final"], "GNi");
  ExpectWithin(1e-3, kSlowBuild ? 0.0293383 : 0.0184841, gni["normalized_chi2"]["mean"], "GNi");
  ExpectWithin(0.01, kSlowBuild ? 27247 : 438560, gni["paper_update_flops"], "GNi");
  ExpectWithin(0.01, kSlowBuild ? 5250 : 36667, gni["paper_solve_flops"], "GNi");
  ExpectWithin(1e-3, kSlowBuild ? 0.0358951 : 780.58, Row(full, "gn1")["normalized_chi2"]["mean"], "GN1");
}

TEST_F(TableCommand, ReproducesThePaperWithPriors) {
  TERSE_NEEDS(folder, "graphs/igg_spo");
  const auto rows = Rows(folder, "--graphs MIT-P --initial file --policies gni-spo-igg");
  const auto& spo = Row(rows, "gni-spo-igg");
  ExpectWithin(1e-3, 0.0172741, spo["normalized_chi2"]["final"], "SPO-IGG");
  ExpectWithin(1e-3, 0.0206264, spo["normalized_chi2"]["mean"], "SPO-IGG");
  ExpectWithin(5e-3, 1.384, spo["ate_m"]["mean"], "SPO-IGG");
  const auto full = Rows(FolderForSlowPolicies(folder, "MIT-P.g2o"), "--graphs MIT-P --initial file --policies gni");
  const auto& gni = Row(full, "gni");
  ExpectWithin(1e-3, kSlowBuild ? 0.0121085 : 0.0172738, gni["normalized_chi2"]["final"], "GNi");
  ExpectWithin(1e-3, kSlowBuild ? 0.0298772 : 0.0199852, gni["normalized_chi2"]["mean"], "GNi");
}

class CompactTable : public TableCommand {
 protected:
  nlohmann::json Table(const std::string& rest) const { return Json("table compact . --json --quiet " + rest); }
};

TEST_F(CompactTable, SaysWhatIsMissing) {
  ExpectFailure("table compact", 2, "DIR");
  ExpectFailure("table compact . --graphs ellipse,nothing", 2, "nothing");
  ExpectFailure("table compact . --sample 2", 2, "--sample");
  ExpectFailure("table compact . --sample nan", 2, "--sample");
  ExpectFailure("table compact . --seed -1", 2, "-1 is not a whole number");
  ExpectFailure("table compact . --graphs ellipse,sphere2500", 1, "sphere2500.g2o: no such file");
  ExpectFailure("table compact nowhere", 1, "kitti00_all_loops.g2o: no such file");
  Write("sphere2500.g2o", "VERTEX_SE3:QUAT 0 0 0\n");
  ExpectFailure("table compact . --graphs sphere2500", 1, "sphere2500.g2o:1");
  Write("taken", "");
  ExpectFailure("table compact . --graphs ellipse --output taken", 1, "taken");
}

TEST_F(CompactTable, AgreesWithItselfOnTheEllipse) {
  const auto json = Table("--graphs ellipse --random-runs 2 --apfl --output figures");
  ASSERT_EQ(json["graphs"].size(), 1u);
  const auto& row = json["graphs"][0];
  EXPECT_EQ(row["graph"], "ellipse");
  EXPECT_EQ(row["reference"], "exact");
  EXPECT_EQ(row["poses"], 170);
  const int links = row["links"];
  EXPECT_EQ(row["recovery"]["v2"], row["fpfl"]["errors"]);
  EXPECT_NE(row["recovery"]["v0"], row["recovery"]["v2"]);
  EXPECT_EQ(row["thresholds"]["range"].size(), 4u);
  EXPECT_EQ(row["apal"]["poses_kept"], 170);
  EXPECT_EQ(row["apal"]["links_kept"], links);
  EXPECT_EQ(row["apal"]["ate_ratio"], 1.0);
  EXPECT_EQ(row["apfl"]["poses_kept"], 170);
  EXPECT_LT(row["fpfl"]["poses_kept"], 170);
  EXPECT_LT(row["fpfl"]["links_kept"], links);
  EXPECT_EQ(row["rfpfl"]["poses_kept"], row["fpfl"]["poses_kept"]);
  EXPECT_LE(row["rfpfl"]["links_kept"], row["fpfl"]["links_kept"]);
  for (const char* strategy : {"apal", "apfl", "fpfl", "rfpfl"}) {
    const auto& of = row[strategy];
    const double kept = of["poses_kept"], ate = of["errors"]["ate"]["translation_m"];
    EXPECT_NEAR(of["poses_percent"].get<double>(), 100 * kept / 170, 1e-9) << strategy;
    EXPECT_NEAR(of["ate_ratio"].get<double>() * row["apal"]["errors"]["ate"]["translation_m"].get<double>(), ate, 1e-9);
    EXPECT_EQ(of["seconds"]["covariances"].is_null(), strategy != std::string("apal")) << strategy;
  }
  const double apal = row["apal"]["seconds"]["total"], fpfl = row["fpfl"]["seconds"]["total"];
  EXPECT_NEAR(row["time_ratio"].get<double>(), apal / fpfl, 1e-6 * apal / fpfl);
  EXPECT_EQ(row["paper"]["poses_percent"], 23.5);
  ASSERT_EQ(json["files"].size(), 4u);
  for (const auto& file : json["files"]) EXPECT_TRUE(Exists(file)) << file;
  EXPECT_EQ(JsonFile("figures/tables.json"), json);
}

// The paper's order: what is left out can only make the map less certain.
TEST_F(CompactTable, NormsAreConservative) {
  Table("--graphs ellipse --random-runs 0 --output figures");
  const auto rows = testing::CsvRows(Read("figures/ellipse_norms.csv"));
  ASSERT_EQ(rows.size(), 3u * 170);
  for (std::size_t k = 0; k < rows.size(); k += 3) {
    EXPECT_EQ(rows[k][1], "apal");
    EXPECT_EQ(rows[k + 1][1], "marginalised");
    EXPECT_EQ(rows[k + 2][1], "fpfl");
    for (std::size_t column = 2; column < 6; ++column) {
      const double apal = std::stod(rows[k][column]), marginalised = std::stod(rows[k + 1][column]);
      const double fpfl = std::stod(rows[k + 2][column]);
      // Each has its own linearisation points.
      EXPECT_LE(apal, 1.05 * marginalised + 1e-12) << "row " << k << " column " << column;
      EXPECT_LE(marginalised, 1.05 * fpfl + 1e-12) << "row " << k << " column " << column;
    }
  }
}

TEST_F(CompactTable, FindsFilesAndReferences) {
  Succeed("generate garage --poses 80 --output parking-garage.g2o");
  std::filesystem::create_directories(folder_ / "deep/down");
  Succeed("generate manhattan --poses 200 --output deep/down/10kHog-man.g2o");
  const auto json = Table("--graphs parking-garage,10kHog-man --random-runs 1");
  ASSERT_EQ(json["graphs"].size(), 2u);
  const auto& garage = json["graphs"][0];
  EXPECT_EQ(garage["reference"], "optimum");
  EXPECT_TRUE(garage["fpfl"]["ate_ratio"].is_null());
  EXPECT_LT(garage["apal"]["errors"]["ate"]["translation_m"], 1e-4) << "is the optimum itself";
  const auto& grid = json["graphs"][1];
  EXPECT_EQ(grid["graph"], "w10000_hogman");
  EXPECT_EQ(grid["reference"], "grid");
  EXPECT_GT(grid["fpfl"]["ate_ratio"], 0);
  EXPECT_TRUE(json["files"].empty());
}

TEST_F(CompactTable, OfAGiantOnlyTheOptimum) {
  const auto row = Table("--graphs ellipse --random-runs 0 --most-poses 100")["graphs"][0];
  EXPECT_TRUE(row["apal"]["seconds"]["total"].is_null());
  EXPECT_TRUE(row["time_ratio"].is_null());
  EXPECT_EQ(row["fpfl"]["errors"]["stride"], 2);
  EXPECT_GT(row["fpfl"]["ate_ratio"], 0);
  EXPECT_TRUE(row["rfpfl"].is_null());
}

TEST_F(CompactTable, TextAndDocument) {
  Write("doc.md", "before\n<!-- tables -->\nstale text\n<!-- /tables -->\nafter\n");
  const std::string text =
      Succeed("table compact . --graphs ellipse-n --laps 2 --random-runs 1 --output f --update doc.md").out;
  for (const char* part : {"Table 1", "Table 2", "Table 3", "Table 4", "FPFL", "ellipse-n", "(27)"}) {
    EXPECT_NE(text.find(part), std::string::npos) << part << '\n' << text;
  }
  const std::string document = Read("doc.md");
  EXPECT_EQ(document.find("stale text"), std::string::npos);
  EXPECT_EQ(document.rfind("before\n<!-- tables -->\n", 0), 0u);
  EXPECT_NE(document.find("<!-- /tables -->\nafter\n"), std::string::npos);
  const auto laps = testing::CsvRows(Read("f/ellipse-n_laps.csv"));
  ASSERT_EQ(laps.size(), 4u);
  EXPECT_EQ(laps[1][1], "2");
  EXPECT_GT(std::stod(laps[1][4]), std::stod(laps[0][4])) << "time adds up";
  Write("plain.md", "nothing to fill\n");
  ExpectFailure("table compact . --graphs ellipse --update plain.md --quiet", 1, "plain.md");
}

class OutliersTable : public TableCommand {
 protected:
  void MakeWalk() const {
    std::filesystem::create_directories(folder_ / "few" / "deep");
    Succeed("generate manhattan --poses 60 --seed 3 --output few/walk.g2o");
  }
  // Times aside, which differ from run to run.
  static nlohmann::json WithoutTimes(nlohmann::json json) {
    for (auto& graph : json["graphs"]) {
      for (const char* list : {"rows", "runs"}) {
        for (auto& entry : graph[list]) entry.erase("seconds"), entry.erase("step_ms");
      }
    }
    return json;
  }
};

TEST_F(OutliersTable, SaysWhatIsMissing) {
  MakeWalk();
  ExpectFailure("table outliers", 2, "DIR");
  ExpectFailure("table outliers nowhere", 1, "nowhere: ");
  ExpectFailure("table outliers few/deep", 1, "few/deep: no graph in it");
  ExpectFailure("table outliers few --graphs wlak", 2, "no graph wlak in few; did you mean walk?");
  for (const char* percents : {"100", "-1", "10,x", "nan"})
    ExpectFailure(std::string("table outliers few --percents ") + percents, 2, "--percents");
  ExpectFailure("table outliers few --methods batch-gncc", 2, "did you mean batch-gnc?");
  ExpectFailure("table outliers few --kinds grouepd", 2, "did you mean grouped?");
  ExpectFailure("table outliers few --seeds 0", 2, "--seeds");
  ExpectFailure("table outliers few --threads 0", 2, "--threads");
  ExpectFailure("table outliers few --update few/walk.g2o", 2, "few/walk.g2o");
  Write("plain.md", "nothing to fill\n");
  ExpectFailure("table outliers few --update plain.md", 1, "plain.md");
  Write("runs.jsonl", "{}\n");
  ExpectFailure("table outliers few --runs runs.jsonl", 1, "runs.jsonl:1");
  std::filesystem::remove(folder_ / "few/walk.g2o");
  Write("few/broken.g2o", "VERTEX_SE2 0 0 0\n");
  ExpectFailure("table outliers few --quiet", 1, "broken.g2o:1");
}

TEST_F(OutliersTable, HoldsEveryRunAndGoesOnAfterFailures) {
  MakeWalk();
  Write("few/a_line.g2o", "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n");
  const std::string arguments =
      "table outliers few --percents 0,50,20,20 --kinds grouped,random --seeds 2 --methods "
      "compact,batch-none,batch-gnc "
      "--quiet --json ";
  const auto json = Json(arguments + "--threads 1");
  EXPECT_EQ(json["percents"], nlohmann::json({0, 20, 50}));
  EXPECT_EQ(json["kinds"], nlohmann::json({"random", "grouped"}));
  EXPECT_EQ(json["methods"], nlohmann::json({"batch-none", "batch-gnc", "compact"}));
  ASSERT_EQ(json["graphs"].size(), 2u);
  EXPECT_EQ(json["graphs"][0]["graph"], "a_line");
  EXPECT_EQ(json["graphs"][0]["failure"], "it has no loops");
  EXPECT_TRUE(json["graphs"][0]["runs"].empty());
  const auto& walk = json["graphs"][1];
  EXPECT_TRUE(walk["failure"].is_null());
  EXPECT_EQ(walk["reference"], "grid");
  EXPECT_EQ(walk["reference_error_m"], 0);
  EXPECT_TRUE(walk["sigma_scale"].is_null());
  const int loops = walk["loops"];
  ASSERT_EQ(walk["runs"].size(), 3u + 2 * 3 * 2 * 2);
  ASSERT_EQ(walk["rows"].size(), 3u + 2 * 3 * 2);
  for (const auto& run : walk["runs"]) {
    SCOPED_TRACE(run.dump());
    const double share = run["percent"].get<double>() / 100, wrong = run["wrong_loops"];
    EXPECT_EQ(run["true_loops"], loops);
    EXPECT_NEAR(wrong, share / (1 - share) * loops, 1) << "a share of all loops";
    EXPECT_EQ(run["step_ms"].is_null(), run["method"] != "compact");
    if (run["method"] != "batch-none") continue;
    EXPECT_EQ(run["recall"], 1.0);
    EXPECT_NEAR(run["precision"].get<double>(), loops / (loops + wrong), 1e-12);
    EXPECT_EQ(run["success"].get<bool>(), run["kind"].is_null());
  }
  ASSERT_EQ(json["summary"].size(), 6u);
  EXPECT_EQ(json["summary"][0]["up_to_50_percent"]["runs"], 4);
  EXPECT_EQ(json["summary"][0]["at_90_percent"]["runs"], 0);
  EXPECT_EQ(json["summary"][0]["ratios"].size(), 2u);
  const auto others = Json(arguments + "--threads 3");
  EXPECT_EQ(WithoutTimes(others), WithoutTimes(json)) << "whatever the threads";
  EXPECT_TRUE(others["graphs"][1]["runs"][2]["step_ms"].is_null()) << "others ran at the same time";
}

TEST_F(OutliersTable, GoesOnWithTheRunsOfAFile) {
  MakeWalk();
  const std::string arguments = "table outliers few --percents 30 --kinds random --methods batch-gnc --quiet --json ";
  Succeed(arguments + "--seeds 1 --runs runs.jsonl");
  std::string first = Read("runs.jsonl");
  EXPECT_EQ(std::count(first.begin(), first.end(), '\n'), 2);
  // That it is taken from there shows in a time that no run takes.
  const std::size_t at = first.rfind("\"seconds\":") + 10, end = first.find(',', at);
  first.replace(at, end - at, "12345.0");
  Write("runs.jsonl", first);
  const auto json = Json(arguments + "--seeds 2 --runs runs.jsonl");
  EXPECT_EQ(json["graphs"][0]["runs"][1]["seconds"], 12345.0);
  EXPECT_LT(json["graphs"][0]["runs"][2]["seconds"], 12345.0);
  const std::string all = Read("runs.jsonl");
  EXPECT_EQ(all.substr(0, first.size()), first);
  EXPECT_EQ(std::count(all.begin(), all.end(), '\n'), 3);
  EXPECT_EQ(WithoutTimes(Json(arguments + "--seeds 2")), WithoutTimes(json));
}

TEST_F(OutliersTable, TextAndDocument) {
  MakeWalk();
  Succeed("generate sphere --poses 60 --output few/deep/ball.g2o --ground-truth few/deep/ball.tum");
  Write("doc.md", "before\n<!-- protocol -->\nstale text\n<!-- /protocol -->\nafter\n");
  const auto outcome = Succeed(
      "table outliers few --percents 90 --kinds random --seeds 1 --methods batch-gnc,incremental-gnc --update doc.md");
  for (const char* part : {"walk: 2D, 60 poses", "ball: 3D, 60 poses", "reference: file", "| clean ", "| random ",
                           "Success over all graphs", "90 %"}) {
    EXPECT_NE(outcome.out.find(part), std::string::npos) << part << '\n' << outcome.out;
    EXPECT_NE(Read("doc.md").find(part), std::string::npos) << part;
  }
  EXPECT_NE(outcome.err.find("walk random 90 % batch-gnc: ATE"), std::string::npos) << outcome.err;
  EXPECT_EQ(Read("doc.md").find("stale text"), std::string::npos);
  const auto failed =
      Json("table outliers few --percents 10 --seeds 1 --run-seconds 1e-9 --graphs ball --json --quiet");
  EXPECT_EQ(failed["graphs"][0]["runs"][0]["failure"], "stopped after 1e-09 s");
  EXPECT_EQ(failed["graphs"][0]["rows"][0]["failed"], 1);
  EXPECT_GT(failed["graphs"][0]["runs"][0]["seconds"], 0);
  const std::string text = Succeed("table outliers few --percents 10 --seeds 1 --run-seconds 1e-9 --quiet").out;
  EXPECT_NE(text.find("- failed: 1 of 1, compact, random, 10 %: stopped after"), std::string::npos) << text;
}

}  // namespace
}  // namespace terse
