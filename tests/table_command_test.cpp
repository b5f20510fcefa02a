// `terse table igg-spo`: the published figures where the public data is present, and its errors. Builds with sanitizers
// take the fast variants only.

#include <gtest/gtest.h>

#include <algorithm>

#include "shared_data.h"
#include "testing_command.h"

namespace terse {
namespace {

class TableCommand : public testing::CommandTest {
 protected:
  nlohmann::json Rows(const std::string& folder, const std::string& rest) const {
    return Json("table igg-spo '" + folder + "' --json --quiet " + rest);
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
  ExpectFailure("table igg-spo . --graphs MIT", 1, "not a 2D graph");
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

// The figures of the paper's Tables as its published code computes them.
TEST_F(TableCommand, ReproducesThePaperOnMit) {
  TERSE_NEEDS(folder, "graphs/igg_spo");
  const std::string full = kSlowBuild ? "" : "gn1,gni,";
  const auto rows = Rows(folder, "--graphs MIT --initial file --policies " + full + "gni-spo-igg");
  const auto& spo = Row(rows, "gni-spo-igg");
  ExpectWithin(1e-3, 0.0165918, spo["normalized_chi2"]["final"], "SPO-IGG");
  ExpectWithin(1e-3, 0.0184891, spo["normalized_chi2"]["mean"], "SPO-IGG");
  ExpectWithin(0.01, 66541, spo["paper_update_flops"], "SPO-IGG");
  if (kSlowBuild) return;
  ASSERT_EQ(rows.size(), 3u);
  const auto& gni = Row(rows, "gni");
  ExpectWithin(1e-3, 0.0165914, gni["normalized_chi2"]["final"], "GNi");
  ExpectWithin(1e-3, 0.0184841, gni["normalized_chi2"]["mean"], "GNi");
  ExpectWithin(0.01, 438560, gni["paper_update_flops"], "GNi");
  ExpectWithin(0.01, 36667, gni["paper_solve_flops"], "GNi");
  ExpectWithin(1e-3, 780.58, Row(rows, "gn1")["normalized_chi2"]["mean"], "GN1");
}

TEST_F(TableCommand, ReproducesThePaperWithPriors) {
  TERSE_NEEDS(folder, "graphs/igg_spo");
  const std::string full = kSlowBuild ? "" : "gni,";
  const auto rows = Rows(folder, "--graphs MIT-P --initial file --policies " + full + "gni-spo-igg");
  const auto& spo = Row(rows, "gni-spo-igg");
  ExpectWithin(1e-3, 0.0172741, spo["normalized_chi2"]["final"], "SPO-IGG");
  ExpectWithin(1e-3, 0.0206264, spo["normalized_chi2"]["mean"], "SPO-IGG");
  ExpectWithin(5e-3, 1.384, spo["ate_m"]["mean"], "SPO-IGG");
  if (kSlowBuild) return;
  const auto& gni = Row(rows, "gni");
  ExpectWithin(1e-3, 0.0172738, gni["normalized_chi2"]["final"], "GNi");
  ExpectWithin(1e-3, 0.0199852, gni["normalized_chi2"]["mean"], "GNi");
}

}  // namespace
}  // namespace terse
