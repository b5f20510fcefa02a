// terse report and terse plot. What the page does with its data is tested in tests/report, in a browser.

#include <sys/stat.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>

#include "testing_command.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

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

// What a bounded map made of links, and the area that was explored.
TEST_F(ReportCommand, TellsWhatAreFusedEdges) {
  Succeed("compact laps.g2o --strategy bounded --output bounded --quiet");
  Succeed("report bounded --output page.html");
  const json run = DataOf("page.html").at("runs").at(0), stats = JsonFile("bounded/stats.json");
  const json &poses = run.at("poses"), &decisions = run.at("decisions");
  const std::size_t count = poses.at("id").size();
  long anchored = 0, with_edges = 0;
  for (std::size_t k = 0; k < count; ++k) {
    const bool is_anchored = run.at("verdicts").at(poses.at("verdict").at(k).get<std::size_t>()) == "anchored";
    EXPECT_EQ(decisions.at("anchored_to").at(k).is_null(), !is_anchored);
    anchored += is_anchored;
    with_edges += !decisions.at("edges").at(k).empty();
    long anchors = 0;
    for (const json& candidate : decisions.at("candidates").at(k)) {
      anchors += candidate.size() > 8 && candidate.at(8) == "anchors";
    }
    EXPECT_EQ(anchors, is_anchored);
  }
  EXPECT_EQ(anchored, stats.at("poses_anchored").get<long>());
  EXPECT_GT(with_edges, 0);
  long several = 0, made_of_links = 0;
  for (const char* kind : {"links", "chain"}) {
    const json& edges = run.at(kind);
    for (std::size_t k = 0; k < edges.at("from").size(); ++k) {
      several += edges.at("measurements").at(k).get<int>() > 1;
      made_of_links += edges.at("made_of_links").at(k).get<int>();
    }
  }
  EXPECT_EQ(several, stats.at("edges_fused").get<long>());
  EXPECT_EQ(made_of_links, stats.at("edges_composed").get<long>());
  const json &area = run.at("area"), &explored = area.at("explored");
  ASSERT_EQ(explored.size(), count);
  const double cell = area.at("cell");
  EXPECT_NEAR(cell, stats.at("thresholds").at("range").at(0).get<double>(), 1e-6 * cell);
  // A lap of the ellipse; the second one finds nothing new but for a cell's corner.
  const double lap = explored.at(count / 2), end = explored.back();
  EXPECT_GT(lap, 10 * cell * cell);
  EXPECT_LE(end, lap + 2 * cell * cell);
  Succeed("plot bounded");
  EXPECT_NE(Read("bounded/timings.svg").find("explored area"), std::string::npos);
}

// R S R', R of the quaternion in trajectory.tum.
TEST_F(ReportCommand, TurnsCovariancesIntoTheWorld) {
  Succeed("report fpfl --output page.html");
  const json covariances = DataOf("page.html").at("runs").at(0).at("covariances");
  const auto rows = CsvRows(Read("fpfl/covariances.csv"));
  ASSERT_EQ(rows.size(), covariances.at("position").size());
  std::map<long, std::vector<double>> quaternions;
  std::istringstream poses(Read("fpfl/trajectory.tum"));
  for (std::string line; std::getline(poses, line);) {
    if (line.empty() || line[0] == '#') continue;
    std::istringstream numbers(line);
    double stamp = 0, x = 0, y = 0, z = 0;
    std::vector<double> q(4);
    numbers >> stamp >> x >> y >> z >> q[0] >> q[1] >> q[2] >> q[3];
    quaternions[static_cast<long>(stamp)] = q;
  }
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const std::vector<double>& q = quaternions.at(std::stol(rows[k][0]));
    const double x = q[0], y = q[1], z = q[2], w = q[3];
    const double R[3][3] = {{1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)},
                            {2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)},
                            {2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)}};
    std::vector<double> expected;
    for (int i = 0; i < 3; ++i) {
      for (int j = i; j < 3; ++j) {
        double sum = 0;
        for (int a = 0; a < 3; ++a) {
          for (int b = 0; b < 3; ++b)
            sum += R[i][a] * std::stod(rows[k][static_cast<std::size_t>(1 + 6 * a + b)]) * R[j][b];
        }
        expected.push_back(sum);
      }
    }
    const double scale = expected[0] + expected[3] + expected[5];
    for (std::size_t e = 0; e < 6; ++e) {
      EXPECT_NEAR(covariances.at("position").at(k).at(e).get<double>(), expected[e], 1e-6 * scale) << k << ' ' << e;
    }
  }
}

// Files of two runs in one folder.
TEST_F(ReportCommand, RefusesAMixture) {
  Succeed("compact laps.g2o --strategy apal --output apal --quiet");
  const std::string stats = Read("fpfl/stats.json"), decisions = Read("fpfl/decisions.jsonl");
  Write("fpfl/stats.json", Read("apal/stats.json"));
  ExpectFailure("report fpfl", 1, "fpfl/stats.json: poses_kept is ");
  Write("fpfl/stats.json", stats);
  const std::size_t first = decisions.find('\n') + 1, second = decisions.find('\n', first) + 1;
  Write("fpfl/decisions.jsonl",
        decisions.substr(first, second - first) + decisions.substr(0, first) + decisions.substr(second));
  ExpectFailure("report fpfl", 1, "fpfl/decisions.jsonl: row 1 is of another pose");
  Write("fpfl/decisions.jsonl", decisions);
  Succeed("report fpfl");
  Succeed("compact laps.g2o --output fpfl --quiet");  // without the truth this time
  EXPECT_FALSE(Exists("fpfl/ground_truth.tum"));
}

TEST_F(ReportCommand, TellsRunsOfTheSameNameApart) {
  std::filesystem::create_directories(folder_ / "other");
  std::filesystem::copy(folder_ / "fpfl", folder_ / "other/fpfl");
  Succeed("report fpfl other/fpfl --output page.html");
  const json runs = DataOf("page.html").at("runs");
  EXPECT_NE(runs.at(0).at("name"), runs.at(1).at("name"));
  EXPECT_EQ(runs.at(1).at("name"), "other/fpfl");
}

// Nothing to scale by, a plane, ids that no trajectory can hold.
TEST_F(ReportCommand, SmallAndOddRuns) {
  Write("one.g2o", "VERTEX_SE2 5 1 2 0.5\n");
  Succeed("compact one.g2o --strategy apal --output one --quiet");
  Succeed("plot one");
  EXPECT_NE(Read("one/trajectory.svg").find(" m</text>"), std::string::npos);
  EXPECT_EQ(Read("one/trajectory.svg").find("e+"), std::string::npos);
  std::string line;  // along x: the plane is still that of x and y
  for (int k = 0; k < 20; ++k) {
    line += "EDGE_SE2 " + std::to_string(k) + ' ' + std::to_string(k + 1) + " 1 0 0 100 0 0 1 0 100\n";
  }
  Write("line.g2o", line);
  Succeed("compact line.g2o --strategy apal --output line --quiet");
  Succeed("plot line --what trajectory");
  const std::string map = Read("line/trajectory.svg");
  double widest = 0;
  for (std::size_t at = 0; (at = map.find(" ry=\"", at)) != std::string::npos; ++at) {
    widest = std::max(widest, std::stod(map.substr(at + 5)));
  }
  EXPECT_GT(widest, 5) << "the uncertainty across";
  Write("huge.g2o", "EDGE_SE2 6989586621679009792 6989586621679009793 1 0 0 100 0 0 1 0 100\n");
  ExpectFailure("compact huge.g2o --output huge", 1, "ids beyond 2^53");
  EXPECT_EQ(Run("compact huge.g2o --output huge -v").err.find("kept"), std::string::npos) << "before the run";
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
  ExpectFailure("report fpfl --output page.html", 1, "the JSON ends too early");
  Write("fpfl/graph.json", "{\"format\": \"terse-compact-graph-1\"}");
  ExpectFailure("report fpfl --output page.html", 1, "fpfl/graph.json: not as terse writes it");
  Write("fpfl/graph.json", graph);
  Write("fpfl/steps.csv", steps.substr(0, steps.rfind('\n', steps.size() - 2) + 1));
  ExpectFailure("report fpfl --output page.html", 1, "the files of one run belong together");
  Write("fpfl/steps.csv", steps + "1,2\n");
  ExpectFailure("report fpfl --output page.html", 1, "expected 10 cells as in the header, found 2");
  Write("fpfl/steps.csv", steps);
  Write("fpfl/decisions.jsonl", "{\n");
  ExpectFailure("report fpfl --output page.html", 1, "fpfl/decisions.jsonl:1: the JSON ends too early");
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

// An ellipse of a run far larger than its panel would hide the other run, the head and the legend.
TEST_F(ReportCommand, ClipsEllipsesToTheirPanel) {
  Succeed("compact laps.g2o --strategy apal --output apal --quiet");
  Succeed("plot fpfl apal --what trajectory --output pictures");
  const std::string map = Read("pictures/comparison_trajectory.svg");
  double right = 0;  // of the panel before
  std::size_t drawn = 0;
  for (int panel = 0; panel < 2; ++panel) {
    const std::string id = "panel-" + std::to_string(panel);
    const std::size_t rectangle = map.find("<clipPath id=\"" + id + "\"><rect ");
    const std::size_t begin = map.find("<g clip-path=\"url(#" + id + ")\">"), end = map.find("</g>", begin);
    ASSERT_NE(rectangle, std::string::npos);
    ASSERT_NE(begin, std::string::npos);
    ASSERT_NE(end, std::string::npos);
    double x = 0, y = 0, width = 0;
    ASSERT_EQ(std::sscanf(map.c_str() + map.find("x=", rectangle), "x=\"%lf\" y=\"%lf\" width=\"%lf\"", &x, &y, &width),
              3);
    EXPECT_GT(x, right) << "panels do not overlap";
    right = x + width;
    for (std::size_t at = begin; (at = map.find("<ellipse rx=", at + 1)) < end;) ++drawn;
  }
  EXPECT_GT(drawn, 0u);
  std::size_t all = 0;
  for (std::size_t at = 0; (at = map.find("<ellipse rx=", at)) != std::string::npos; ++at) ++all;
  EXPECT_EQ(drawn, all) << "no ellipse is outside";
}

// Links that somebody put where a temporary file might be made lead nowhere, and one at the picture's own name leads to
// the picture.
TEST_F(ReportCommand, FollowsNoPlantedLink) {
  Write("precious", "not for writing");
  std::filesystem::create_directory(Path("shared"));
  for (const char* name : {"trajectory.png.new", "trajectory.tmp.svg", "trajectory.svg"}) {
    std::filesystem::create_symlink(Path("precious"), Path("shared") + "/" + name);
  }
  std::filesystem::create_directory(Path("tmp"));
  setenv("TMPDIR", Path("tmp").c_str(), 1);
  Succeed("plot fpfl --what trajectory --format png --width 320 --output shared");
  unsetenv("TMPDIR");
  EXPECT_EQ(Read("precious"), "not for writing");
  EXPECT_EQ(Read("shared/trajectory.png").substr(1, 3), "PNG");
  long files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(Path("shared"))) files += entry.is_symlink() ? 0 : 1;
  EXPECT_EQ(files, 1) << "nothing but the picture is left";
  EXPECT_TRUE(std::filesystem::is_empty(Path("tmp")));
}

// A program of that name that fails leaves the old picture as it was.
TEST_F(ReportCommand, KeepsThePictureThatCannotBeDrawnAgain) {
  std::filesystem::create_directory(Path("bin"));
  Write("bin/rsvg-convert", "#!/bin/sh\necho half a picture\nexit 3\n");
  std::filesystem::permissions(Path("bin/rsvg-convert"), std::filesystem::perms::owner_all);
  std::filesystem::create_directory(Path("kept"));
  Write("kept/trajectory.png", "old");
  const std::string path = std::getenv("PATH");
  setenv("PATH", (Path("bin") + ":" + path).c_str(), 1);
  ExpectFailure("plot fpfl --what trajectory --format png --output kept", 1, "rsvg-convert could not draw it");
  setenv("PATH", path.c_str(), 1);
  EXPECT_EQ(Read("kept/trajectory.png"), "old");
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(Path("kept")), std::filesystem::directory_iterator()), 1);
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
