// `terse sweep` as its users see it.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <iterator>

#include "testing_command.h"

namespace terse {
namespace {

using testing::CsvRows;

class SweepCommand : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate manhattan --poses 250 --output in.g2o --ground-truth truth.tum");
  }
};

TEST_F(SweepCommand, ScalesOneThreshold) {
  const std::string text =
      Succeed("sweep in.g2o --threshold pose --from 0.01 --to 100 --steps 3 --csv p.csv --svg p.svg").out;
  EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 6) << text;
  EXPECT_NE(text.find("optimum"), std::string::npos) << text;
  const auto rows = CsvRows(Read("p.csv"));
  ASSERT_EQ(rows.size(), 3u);
  const double scales[] = {0.01, 1, 100};
  for (std::size_t k = 0; k < rows.size(); ++k) {
    ASSERT_EQ(rows[k].size(), 12u);
    EXPECT_NEAR(std::stod(rows[k][0]), scales[k], 1e-9);
    EXPECT_EQ(rows[k][1], rows[0][1]) << "the range stays";
    EXPECT_EQ(rows[k][2], rows[0][2]) << "the gain of a link stays";
    EXPECT_NEAR(std::stod(rows[k][3]), scales[k] * std::stod(rows[1][3]), 1e-9 * std::stod(rows[k][3]));
    EXPECT_NEAR(std::stod(rows[k][5]), 100 * std::stod(rows[k][4]) / 250, 1e-9);
    EXPECT_GE(std::stod(rows[k][10]), 0);
  }
  EXPECT_GT(std::stoi(rows[0][4]), std::stoi(rows[2][4])) << "fewer poses where more is asked of them";
  const std::string picture = Read("p.svg");
  EXPECT_EQ(picture.rfind("<svg", 0), 0u);
  EXPECT_NE(picture.find("</svg>"), std::string::npos);
  EXPECT_NE(picture.find("<polyline"), std::string::npos);
  EXPECT_EQ(picture.find("nan"), std::string::npos);
  EXPECT_EQ(picture.find("inf"), std::string::npos);
}

TEST_F(SweepCommand, AtScaleOneItIsCompact) {
  Succeed("sweep in.g2o --threshold loop --from 1 --to 1 --steps 1 --ground-truth truth.tum --csv l.csv");
  const auto row = CsvRows(Read("l.csv")).at(0);
  Succeed("compact in.g2o --strategy fpfl --output few");
  const auto thresholds = JsonFile("few/thresholds.json");
  EXPECT_NEAR(std::stod(row[2]), thresholds["min_loop_gain"], 1e-9) << "the thresholds of fpfl, too";
  EXPECT_NEAR(std::stod(row[3]), thresholds["min_pose_gain"], 1e-9);
  const auto stats = JsonFile("few/stats.json");
  EXPECT_EQ(std::stoi(row[4]), stats["poses_kept"]);
  EXPECT_EQ(std::stoi(row[6]), stats["links_kept"]);
  EXPECT_EQ(std::stoi(row[8]), stats["registrations_tried"]);
  Succeed("sweep in.g2o --threshold loop --from 0.5 --to 1 --steps 2 --thresholds few/thresholds.json --csv f.csv");
  const auto same = CsvRows(Read("f.csv")).at(1);
  for (const std::size_t column : {1, 2, 3, 4, 6, 8}) EXPECT_EQ(same[column], row[column]) << column;
  const auto errors = Json("evaluate few/trajectory.tum truth.tum --align se2 --json");
  EXPECT_NEAR(std::stod(row[10]), errors["ate"]["translation_m"].get<double>(), 1e-6);
}

TEST_F(SweepCommand, LinksAndRangeToo) {
  Succeed("sweep in.g2o --threshold loop --from 0.1 --to 1e6 --steps 2 --csv l.csv");
  const auto links = CsvRows(Read("l.csv"));
  EXPECT_GT(std::stoi(links[0][6]), 0);
  EXPECT_EQ(std::stoi(links[1][6]), 0);
  Succeed("sweep in.g2o --threshold range --from 1e-6 --to 1 --steps 2 --csv r.csv");
  const auto range = CsvRows(Read("r.csv"));
  EXPECT_EQ(std::stoi(range[0][4]), 250) << "nothing in range: all are kept";
  EXPECT_LT(std::stoi(range[1][4]), 250);
}

// The rows of one map, with the name that is their first column.
std::vector<std::vector<std::string>> RowsOf(const std::vector<std::vector<std::string>>& rows,
                                             const std::string& map) {
  std::vector<std::vector<std::string>> out;
  std::copy_if(rows.begin(), rows.end(), std::back_inserter(out), [&](const auto& row) { return row.at(0) == map; });
  return out;
}

TEST_F(SweepCommand, WithoutAThresholdItDrawsSizeAgainstError) {
  const std::string text = Succeed(
                               "sweep in.g2o --ground-truth truth.tum --from 0.5 --to 2 --steps 3 --random-runs 2 "
                               "--seed 7 --csv f.csv --svg f.svg")
                               .out;
  EXPECT_NE(text.find("with all poses and links"), std::string::npos) << text;
  const auto rows = CsvRows(Read("f.csv"));
  ASSERT_EQ(rows.size(), 12u);
  for (const std::string strategy : {"fpfl", "bounded"}) {
    const auto informed = RowsOf(rows, strategy), random = RowsOf(rows, "random size of " + strategy);
    ASSERT_EQ(informed.size(), 3u);
    ASSERT_EQ(random.size(), 3u);
    EXPECT_GT(std::stoi(informed[0][4]), std::stoi(informed[2][4])) << "fewer poses where more is asked of them";
    for (std::size_t k = 0; k < 3; ++k) {
      ASSERT_EQ(informed[k].size(), 14u);
      EXPECT_NEAR(std::stod(informed[k][1]), 0.5 * std::pow(2, static_cast<double>(k)), 1e-12);
      EXPECT_NEAR(std::stod(informed[k][2]), std::stod(informed[0][2]) * std::pow(2, static_cast<double>(k)), 1e-9);
      EXPECT_NEAR(std::stod(informed[k][5]), 100 * std::stod(informed[k][4]) / 250, 1e-9);
      EXPECT_EQ(informed[k][10], informed[k][12]) << "one map";
      EXPECT_EQ(random[k][4], informed[k][4]) << "as many poses";
      EXPECT_LE(std::stoi(random[k][6]), std::stoi(informed[k][6])) << "no more links";
      EXPECT_LE(std::stod(random[k][12]), std::stod(random[k][10]));
      EXPECT_GE(std::stod(random[k][13]), std::stod(random[k][10]));
    }
    // The middle one is a run of compact.
    Succeed("compact in.g2o --strategy " + strategy + " --ground-truth truth.tum --output run_" + strategy);
    const auto stats = JsonFile("run_" + strategy + "/stats.json");
    EXPECT_EQ(std::stoi(informed[1][4]), stats["poses_kept"]);
    EXPECT_EQ(std::stoi(informed[1][6]), stats["links_kept"]);
    EXPECT_NEAR(std::stod(informed[1][10]), stats["errors"]["ate_m"].get<double>(), 1e-6);
  }
  const std::string picture = Read("f.svg");
  for (const char* word : {"fpfl", "bounded", "random, size of fpfl", "all poses and links",
                           "poses kept, % of all poses", "links kept, % of all links", "ATE to the ground truth, m"}) {
    EXPECT_NE(picture.find(word), std::string::npos) << word;
  }
  EXPECT_EQ(picture.find("nan"), std::string::npos);
  Succeed(
      "sweep in.g2o --ground-truth truth.tum --from 0.5 --to 2 --steps 3 --random-runs 2 --seed 7 --csv again.csv "
      "--quiet");
  const auto again = CsvRows(Read("again.csv"));
  for (std::size_t k = 0; k < rows.size(); ++k) EXPECT_EQ(again[k][10], rows[k][10]) << "same seed, same maps";
}

TEST_F(SweepCommand, RandomMapsCanBeLeftOut) {
  Succeed("sweep in.g2o --steps 1 --from 1 --random-runs 0 --csv f.csv --svg f.svg");
  const auto rows = CsvRows(Read("f.csv"));
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows[0][0], "fpfl");
  EXPECT_EQ(rows[1][0], "bounded");
  EXPECT_NE(Read("f.svg").find("ATE to the full optimum, m"), std::string::npos);
}

TEST_F(SweepCommand, SaysWhatIsWrong) {
  ExpectFailure("sweep in.g2o --threshold loop --random-runs 2", 2, "--random-runs");
  ExpectFailure("sweep in.g2o --ground-truth nowhere.tum", 1, "nowhere.tum");
  ExpectFailure("sweep in.g2o --threshold colour", 2, "colour");
  ExpectFailure("sweep in.g2o --threshold loop --from 0", 2, "--from");
  ExpectFailure("sweep in.g2o --threshold loop --steps 0", 2, "--steps");
  ExpectFailure("sweep nowhere.g2o --threshold loop", 1, "nowhere.g2o");
  ExpectFailure("sweep in.g2o --threshold loop --csv nowhere/a.csv", 1, "nowhere/a.csv");
  ExpectFailure("sweep in.g2o --threshold loop --ground-truth nowhere.tum", 1, "nowhere.tum");
  ExpectFailure("sweep in.g2o --threshold loop --thresholds nowhere.json", 1, "nowhere.json");
  ExpectFailure("sweep in.g2o --threshold loop --thresholds a.json --sample 0.5", 2, "--sample");
}

}  // namespace
}  // namespace terse
