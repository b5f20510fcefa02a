// `terse sweep` as its users see it.

#include <gtest/gtest.h>

#include <algorithm>

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

TEST_F(SweepCommand, SaysWhatIsWrong) {
  ExpectFailure("sweep in.g2o", 2, "--threshold");
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
