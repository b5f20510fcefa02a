// terse report and terse plot. What the page does with its data is tested in tests/report, in a browser.

#include <sys/stat.h>

#include <cmath>

#include "testing_command.h"

namespace terse {
namespace {

using nlohmann::json;
using testing::CsvRows;
using testing::Outcome;

class ReportCommand : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate ellipse-n --laps 2 --seed 3 --output laps.g2o --ground-truth laps.tum");
    Succeed("compact laps.g2o --strategy fpfl --ground-truth laps.tum --output fpfl --quiet");
  }
  // What the page holds.
  json DataOf(const std::string& page) const {
    const std::string text = Read(page), begin = "id=\"terse-data\">";
    const std::size_t at = text.find(begin), end = text.find("</script>", at);
    EXPECT_NE(at, std::string::npos);
    EXPECT_EQ(text.find("@TERSE_REPORT_DATA@"), std::string::npos);
    return json::parse(text.substr(at + begin.size(), end - at - begin.size()));
  }
};

TEST_F(ReportCommand, HoldsTheRun) {
  const Outcome outcome = Succeed("report fpfl --output page.html");
  EXPECT_NE(outcome.out.find("page.html"), std::string::npos);
  const json data = DataOf("page.html");
  EXPECT_EQ(data.at("format"), "terse-report-1");
  ASSERT_EQ(data.at("runs").size(), 1u);
  const json& run = data.at("runs").at(0);
  const json stats = JsonFile("fpfl/stats.json");
  EXPECT_EQ(run.at("stats"), stats);
  EXPECT_EQ(run.at("name"), "fpfl");
  const std::size_t poses = stats.at("poses").get<std::size_t>();
  for (const char* key : {"id", "kept", "verdict", "x", "y", "z"}) EXPECT_EQ(run.at("poses").at(key).size(), poses);
  EXPECT_EQ(run.at("truth").at("x").size(), poses);
  for (const auto& [name, column] : run.at("steps").items()) EXPECT_EQ(column.size(), poses) << name;
  EXPECT_EQ(run.at("links").at("from").size(), stats.at("links_kept").get<std::size_t>());
  EXPECT_EQ(run.at("covariances").at("pose").size(), stats.at("poses_kept").get<std::size_t>());
  EXPECT_FALSE(run.at("thresholds").contains("link_covariance"));
  // The verdicts, by name, are those of decisions.csv; a link's ends are kept poses.
  const auto decisions = CsvRows(Read("fpfl/decisions.csv"));
  ASSERT_EQ(decisions.size(), poses);
  for (std::size_t k = 0; k < poses; ++k) {
    EXPECT_EQ(run.at("verdicts").at(run.at("poses").at("verdict").at(k).get<std::size_t>()), decisions[k][2]);
  }
  for (const char* end : {"from", "to"}) {
    for (const auto& pose : run.at("links").at(end))
      EXPECT_EQ(run.at("poses").at("kept").at(pose.get<std::size_t>()), 1);
  }
  // The true poses are laid over the estimate: they lie as far from it as the ATE says.
  double squares = 0;
  for (std::size_t k = 0; k < poses; ++k) {
    for (const char* axis : {"x", "y", "z"}) {
      const double gap = run.at("truth").at(axis).at(k).get<double>() - run.at("poses").at(axis).at(k).get<double>();
      squares += gap * gap;
    }
  }
  const double ate = stats.at("errors").at("ate_m").get<double>();
  EXPECT_NEAR(std::sqrt(squares / static_cast<double>(poses)), ate, 1e-5 * ate);
}

// Sums over the rows are invariant under the rotation into the world frame.
TEST_F(ReportCommand, TurnsCovariancesIntoTheWorld) {
  Succeed("report fpfl --output page.html");
  const json covariances = DataOf("page.html").at("runs").at(0).at("covariances");
  const auto rows = CsvRows(Read("fpfl/covariances.csv"));
  ASSERT_EQ(rows.size(), covariances.at("position").size());
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const json& c = covariances.at("position").at(k);
    const double trace = std::stod(rows[k][1]) + std::stod(rows[k][8]) + std::stod(rows[k][15]);
    EXPECT_NEAR(c.at(0).get<double>() + c.at(3).get<double>() + c.at(5).get<double>(), trace, 1e-6 * trace);
  }
}

TEST_F(ReportCommand, ComparesTwoRuns) {
  Succeed("compact laps.g2o --strategy apal --output apal --quiet");
  Succeed("report apal fpfl --quiet");
  const json data = DataOf("apal/comparison.html");
  ASSERT_EQ(data.at("runs").size(), 2u);
  EXPECT_EQ(data.at("runs").at(0).at("name"), "apal");
  EXPECT_TRUE(data.at("runs").at(0).at("truth").is_null());
  EXPECT_EQ(data.at("runs").at(1).at("name"), "fpfl");
  ExpectFailure("report apal fpfl apal", 2, "");
}

TEST_F(ReportCommand, EscapesWhatWouldEndTheScript) {
  Succeed("compact laps.g2o --strategy fpfl --output '<b><script>' --quiet");
  Succeed("report '<b><script>' --output page.html --quiet");
  EXPECT_EQ(DataOf("page.html").at("runs").at(0).at("name"), "<b><script>");
}

TEST_F(ReportCommand, SaysWhatIsWrong) {
  ExpectFailure("report nowhere", 1, "nowhere: no such folder; expected one written by terse compact");
  ExpectFailure("report .", 1, "graph.json: cannot read; expected a folder written by terse compact");
  const std::string graph = Read("fpfl/graph.json"), steps = Read("fpfl/steps.csv");
  Write("fpfl/graph.json", graph.substr(0, graph.size() / 2));
  ExpectFailure("report fpfl --output page.html", 1, "fpfl/graph.json: expected a JSON object");
  Write("fpfl/graph.json", "{\"format\": \"terse-compact-graph-1\"}");
  ExpectFailure("report fpfl --output page.html", 1, "fpfl/graph.json: not as terse writes it");
  Write("fpfl/graph.json", graph);
  Write("fpfl/steps.csv", steps.substr(0, steps.rfind('\n', steps.size() - 2) + 1));
  ExpectFailure("report fpfl --output page.html", 1, "the files of one run belong together");
  Write("fpfl/steps.csv", steps + "1,2\n");
  ExpectFailure("report fpfl --output page.html", 1, "expected 10 cells as in the header, found 2");
  Write("fpfl/steps.csv", steps);
  Write("fpfl/decisions.jsonl", "{\n");
  ExpectFailure("report fpfl --output page.html", 1, "fpfl/decisions.jsonl:1: not as terse writes it");
  EXPECT_FALSE(Exists("page.html"));
}

TEST_F(ReportCommand, OpensTheBrowser) {
  Write("xdg-open", "#!/bin/sh\nprintf %s \"$1\" > opened\n");
  ASSERT_EQ(chmod(Path("xdg-open").c_str(), 0755), 0);
  const std::string path = std::getenv("PATH");
  setenv("PATH", (folder_.string() + ":" + path).c_str(), 1);
  Succeed("report fpfl --open --output page.html");
  EXPECT_EQ(std::filesystem::path(Read("opened")), std::filesystem::canonical(Path("page.html")));
  Write("xdg-open", "#!/bin/sh\nexit 3\n");
  const Outcome outcome = Run("report fpfl --open --quiet --output page.html");
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_NE(outcome.err.find("written, but xdg-open could not open it"), std::string::npos) << outcome.err;
  setenv("PATH", path.c_str(), 1);
}

TEST_F(ReportCommand, DrawsForPapers) {
  const Outcome outcome = Succeed("plot fpfl --output pictures");
  EXPECT_EQ(outcome.out, "pictures/trajectory.svg\npictures/gains.svg\npictures/timings.svg\n");
  const json stats = JsonFile("fpfl/stats.json");
  const std::string map = Read("pictures/trajectory.svg");
  const auto count = [&](const std::string& element) {
    long n = 0;
    for (std::size_t at = 0; (at = map.find(element, at)) != std::string::npos; ++at) ++n;
    return n;
  };
  EXPECT_EQ(count("<circle"), stats.at("poses_kept").get<long>() + 1);  // one in the legend
  EXPECT_EQ(count("<path d=\"M") - count("<path d=\"M0,-4h16") - 1, stats.at("links_kept").get<long>());  // and a scale
  EXPECT_EQ(count("<polyline"), 2);  // truth and estimate
  for (const char* name : {"trajectory", "gains", "timings"}) {
    const std::string svg = Read(std::string("pictures/") + name + ".svg");
    EXPECT_EQ(svg.rfind("<svg ", 0), 0u);
    EXPECT_EQ(svg.find("nan"), std::string::npos) << name;
    EXPECT_EQ(svg.find("inf\""), std::string::npos) << name;
  }
}

TEST_F(ReportCommand, DrawsPng) {
  Succeed("plot fpfl --what trajectory --format png --width 640 --output pictures");
  const std::string png = Read("pictures/trajectory.png");
  ASSERT_GT(png.size(), 24u);
  EXPECT_EQ(png.substr(1, 3), "PNG");
  EXPECT_EQ(static_cast<unsigned char>(png[18]) * 256 + static_cast<unsigned char>(png[19]), 640);
  EXPECT_FALSE(Exists("pictures/trajectory.svg"));
  const std::string path = std::getenv("PATH");
  setenv("PATH", "/nowhere", 1);
  const std::string terse =
      "'" TERSE_COMMAND "' plot '" + Path("fpfl") + "' --format png --quiet 2> '" + Path("error") + "'";
  EXPECT_NE(std::system(terse.c_str()), 0);
  setenv("PATH", path.c_str(), 1);
  EXPECT_NE(Read("error").find("needs the program rsvg-convert (package librsvg2-bin on Debian)"), std::string::npos);
}

}  // namespace
}  // namespace terse
