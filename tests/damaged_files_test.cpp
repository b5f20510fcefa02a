// The command on files that are damaged, endless, or made to break it: a clear error, and nothing written.

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdint>
#include <filesystem>

#include "slow_build.h"
#include "testing_command.h"

namespace terse {
namespace {

using nlohmann::json;
using testing::Outcome;

class DamagedFiles : public testing::CommandTest {
 protected:
  void MakeRun() const {
    Succeed("generate ellipse-n --laps 1 --seed 3 --output in.g2o --ground-truth in.tum");
    Succeed("compact in.g2o --strategy fpfl --ground-truth in.tum --quiet --output run");
  }
  long FilesIn(const std::string& folder) const {
    if (!Exists(folder)) return 0;
    const std::filesystem::directory_iterator begin(Path(folder)), end;
    return static_cast<long>(std::distance(begin, end));
  }
  // The command fails on the changed file as it should; the file is as before afterwards.
  void ExpectRefused(const std::string& file, const std::string& content, const std::string& command,
                     const std::string& cause) const {
    const std::string before = Read(file);
    Write(file, content);
    ExpectFailure(command, 1, cause);
    Write(file, before);
  }
  void ExpectRefused(const std::string& file, const json& pointer_and_value, const std::string& cause) const {
    json changed = JsonFile(file);
    changed[json::json_pointer(pointer_and_value[0].get<std::string>())] = pointer_and_value[1];
    ExpectRefused(file, changed.dump(), "report run --output page.html", cause);
    EXPECT_FALSE(Exists("page.html"));
  }
};

std::string Deep() {
  std::string out;
  for (int k = 0; k < 100000; ++k) out += "{\"a\":";
  return out;
}

TEST_F(DamagedFiles, DeepJson) {
  MakeRun();
  const std::string list(100000, '['), cause = ":1: JSON nested deeper than 100 lists and objects, at byte ";
  for (const std::string& deep : {Deep(), "{\"format\":" + list + std::string(100000, ']') + '}'}) {
    for (const std::string file : {"run/graph.json", "run/stats.json", "run/thresholds.json", "run/decisions.jsonl"}) {
      ExpectRefused(file, deep, "report run --output page.html", file + cause);
    }
    ExpectRefused("run/stats.json", deep, "plot run --output picture", "run/stats.json" + cause);
    ExpectRefused("run/graph.json", deep, "compact in.g2o --continue run --output new", "run/graph.json" + cause);
    ExpectRefused("run/thresholds.json", deep, "online --thresholds run/thresholds.json < in.g2o",
                  "run/thresholds.json" + cause);
    ExpectRefused("run/thresholds.json", deep, "compact in.g2o --thresholds run/thresholds.json --output new",
                  "run/thresholds.json" + cause);
  }
  EXPECT_FALSE(Exists("page.html") || Exists("new/graph.json") || FilesIn("picture") > 0);
}

TEST_F(DamagedFiles, RunsWithNumbersThatAreNone) {
  MakeRun();
  ExpectRefused("run/graph.json", {"/dimension", 7}, "run/graph.json: dimension: 7, expected 2 or 3");
  ExpectRefused("run/graph.json", {"/dimension", 1e300}, "1e+300, expected a whole number");
  ExpectRefused("run/graph.json", {"/poses/3/id", 1e300}, "1e+300, expected a whole number");
  ExpectRefused("run/graph.json", {"/poses/3/id", 0}, "pose 0 is there twice");
  ExpectRefused("run/graph.json", {"/edges/0/from", -1e19}, "-1e+19, expected a whole number");
  ExpectRefused("run/graph.json", {"/edges/0/from", json::array()}, "[], expected a whole number");
  const std::string trajectory = Read("run/trajectory.tum"), covariances = Read("run/covariances.csv");
  ExpectRefused("run/trajectory.tum",
                trajectory.substr(0, trajectory.rfind('\n', trajectory.size() - 2) + 1) + "1e300 0 0 0 0 0 0 1\n",
                "report run --output page.html", "its stamps are not the ids");
  for (const std::string id : {"1e300", "", "nan", "0.5", "-inf"}) {
    const std::size_t row = covariances.find('\n') + 1;
    ExpectRefused("run/covariances.csv",
                  covariances.substr(0, row) + id + covariances.substr(covariances.find(',', row)),
                  "report run --output page.html", "covariances.csv:2: expected the id of a pose");
  }
  Succeed("report run --output page.html");
}

TEST_F(DamagedFiles, EndlessInput) {
  MakeRun();
  for (const std::string endless : {"/dev/zero", "/dev/urandom"}) {
    for (const std::string command :
         {"info E", "solve E", "compact E --output new", "convert E out.tum", "evaluate E in.tum", "evaluate in.tum E",
          "covariance E", "compact in.g2o --ground-truth E --output new", "compact in.g2o --thresholds E --output new",
          "online --thresholds E < in.g2o"}) {
      std::string line = command;
      line.replace(line.find('E'), 1, endless);
      ExpectFailure(line, 1, endless + ":");
    }
  }
  EXPECT_FALSE(Exists("new/graph.json") || Exists("out.tum"));
}

TEST_F(DamagedFiles, InputLargerThanMemory) {
  // As much as is refused on this machine, and no more: any file system takes it.
  const auto memory =
      static_cast<std::uintmax_t>(::sysconf(_SC_PHYS_PAGES)) * static_cast<std::uintmax_t>(::sysconf(_SC_PAGESIZE));
  Write("large.g2o", "");
  std::filesystem::resize_file(Path("large.g2o"), 2 * memory + 1);
  ExpectFailure("info large.g2o", 1, "large.g2o: the file is too large or has no end, expected at most ");
  if (kSlowBuild) GTEST_SKIP() << "sanitizers reserve more than is allowed here";
  const Outcome outcome =
      Run("--version > /dev/null; ulimit -v 600000; yes EDGE_SE2 | '" TERSE_COMMAND "' info /dev/stdin");
  EXPECT_EQ(outcome.exit_code, 1);
  EXPECT_NE(outcome.err.find("terse: error: /dev/stdin: the file is too large or has no end"), std::string::npos)
      << outcome.err;
}

TEST_F(DamagedFiles, FixOfManyPoses) {
  Succeed("generate ellipse-n --laps 1 --seed 3 --output in.g2o");
  std::string fix = "FIX";
  for (int k = 0; k < 60; ++k) fix += ' ' + std::to_string(k);
  Write("fixed.g2o", Read("in.g2o") + fix + '\n');
  Succeed("solve fixed.g2o --output out.g2o");
  EXPECT_NE(Read("out.g2o").find("FIX 59\n"), std::string::npos);
}

TEST_F(DamagedFiles, SmallestId) {
  Write("least.g2o",
        "EDGE_SE2 -9223372036854775808 1 1 0 0 1 0 0 1 0 1\n"
        "EDGE_SE2 1 2 1 0 0 1 0 0 1 0 1\n");
  Succeed("solve least.g2o --output solved.g2o");
  EXPECT_NE(Read("solved.g2o").find("VERTEX_SE2 -9223372036854775808 0 0 0\n"), std::string::npos);
  for (const std::string command :
       {"compact least.g2o --strategy apal --output new", "solve least.g2o --trajectory out.tum"}) {
    ExpectFailure(command, 1, "pose -9223372036854775808: ids beyond 2^53 do not fit into the stamps");
  }
  Succeed("solve least.g2o --output solved.g2o");
  ExpectFailure("convert solved.g2o out.tum", 1, "solved.g2o: pose -9223372036854775808: ids beyond 2^53");
  EXPECT_FALSE(Exists("new/graph.json") || Exists("out.tum"));
}

// Bytes that are no text become replacement characters in JSON, whatever it tells of them.
TEST_F(DamagedFiles, NamesThatAreNoText) {
  Succeed("generate ellipse-n --laps 1 --seed 3 --output in.g2o");
  Write("in\xff.g2o", Read("in.g2o"));
  EXPECT_EQ(json::parse(Succeed("info in\xff.g2o --json").out)["poses"], 207);
  Succeed("compact in\xff.g2o --strategy fpfl --quiet --output run\xff");
  Succeed("report run\xff --output page.html --quiet");
  EXPECT_TRUE(json::accept(Read("run\xff/stats.json")));
}

TEST_F(DamagedFiles, VerboseTakesNoValue) {
  Succeed("generate ellipse-n --laps 1 --seed 3 --output in.g2o");
  for (const std::string value : {"abc", "2", "false", "99999999999999999999"}) {
    ExpectFailure("solve in.g2o --verbose=" + value, 2, "verbose");
  }
  EXPECT_NE(Succeed("solve in.g2o -vv --output out.g2o").err.find("terse: "), std::string::npos);
}

}  // namespace
}  // namespace terse
