// No command writes over what it reads, nor two results to one place; and whatever it prints, a full disk is an error.

#include <filesystem>

#include "testing_command.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

class OutputPaths : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate ellipse --output g.g2o --ground-truth t.tum");
    graph_ = Read("g.g2o");
    truth_ = Read("t.tum");
  }
  // Exit code 2, before anything is written.
  void ExpectRefused(const std::string& arguments, const std::string& cause = "is the same file as") const {
    const long files = FileCount();
    ExpectFailure(arguments, 2, cause);
    EXPECT_EQ(Read("g.g2o"), graph_) << arguments;
    EXPECT_EQ(Read("t.tum"), truth_) << arguments;
    EXPECT_EQ(FileCount(), files) << arguments;
  }
  std::string graph_, truth_;
};

TEST_F(OutputPaths, InputsAreNotOverwritten) {
  ExpectRefused("solve g.g2o --stats g.g2o",
                "--stats: g.g2o is the same file as the input g.g2o (FILE), which it would overwrite");
  for (const char* option : {"--output", "--trajectory", "--covariance-output", "--stats", "--steps"}) {
    const std::string extra = std::string(option) == "--steps" ? " --mode incremental" : "";
    if (std::string(option) != "--trajectory") ExpectRefused("solve g.g2o" + extra + " " + option + " g.g2o");
  }
  ExpectRefused("convert g.g2o g.g2o");
  ExpectRefused("convert t.tum t.tum");
  ExpectRefused("covariance g.g2o --output g.g2o");
  ExpectRefused("generate --from g.g2o --outliers 5 --output g.g2o");
  ExpectRefused("generate --from g.g2o --outliers 5 --output o.g2o --outliers-list g.g2o");
  ExpectRefused("sweep g.g2o --threshold pose --csv g.g2o");
  ExpectRefused("sweep g.g2o --threshold pose --ground-truth t.tum --svg t.tum");
  ExpectRefused("online --range 10 10 10 1.5 --journal g.g2o < g.g2o", "the input /dev/stdin (standard input)");
}

TEST_F(OutputPaths, WhateverTheFileIsCalled) {
  fs::create_symlink("g.g2o", Path("link.g2o"));
  fs::create_hard_link(Path("g.g2o"), Path("hard.g2o"));
  fs::create_directory(Path("d"));
  fs::create_directory_symlink("d", Path("e"));
  for (const char* name : {"./g.g2o", "d/../g.g2o", "link.g2o", "hard.g2o", "e/../g.g2o"}) {
    ExpectRefused(std::string("solve g.g2o --output ") + name);
    ExpectRefused(std::string("solve ") + name + " --stats g.g2o");
  }
  ExpectRefused("solve g.g2o --output '" + Path("g.g2o") + "'");
  ExpectRefused("solve g.g2o --output d/new --stats e/new");
}

TEST_F(OutputPaths, OutputsHaveAPlaceEach) {
  ExpectRefused("solve g.g2o --output new --stats ./new",
                "--stats: ./new is the same file as new (--output), expected a place of its own for each output");
  ExpectRefused("generate ellipse --output new --ground-truth new");
  ExpectRefused("generate ellipse --outliers 5 --output a.g2o --ground-truth new --outliers-list new");
  ExpectRefused("sweep g.g2o --threshold pose --csv new --svg new");
  Write("old", "from before");
  ExpectRefused("solve g.g2o --stats old --covariance-output old");
  EXPECT_EQ(Read("old"), "from before");
}

// Decisions between the records of a journal would damage it.
TEST_F(OutputPaths, WhatIsPrintedGoesIntoNoOutput) {
  Write("journal", "");
  for (const char* stream : {">> journal", "> /dev/null 2>> journal"}) {
    const std::string line = std::string("cd '") + Path("") +
                             "' && '" TERSE_COMMAND "' online --strategy apal --journal journal < g.g2o " + stream;
    const int status = std::system(line.c_str());
    ASSERT_TRUE(WIFEXITED(status));
    EXPECT_EQ(WEXITSTATUS(status), 2) << stream;
  }
  EXPECT_NE(Read("journal").find("--journal: journal is the same file as its messages (standard error)"),
            std::string::npos);
}

TEST_F(OutputPaths, WhatIsNoFileMayBeNamedTwice) {
  Succeed("solve g.g2o --output /dev/null --stats /dev/null --quiet");
  Succeed("solve g.g2o --output /dev/stdout --stats /dev/stdout --quiet");
  Succeed("convert g.g2o new.g2o");
}

TEST_F(OutputPaths, FilesOfARunAreInputsToo) {
  Succeed("compact g.g2o --ground-truth t.tum --output run --quiet");
  const std::string map = Read("run/compact.g2o"), stats = Read("run/stats.json");
  ExpectRefused("compact run/compact.g2o --output run", "run/compact.g2o is the same file as the input");
  ExpectRefused("compact g.g2o --thresholds run/thresholds.json --output run", "(--thresholds)");
  ExpectRefused("compact g.g2o --ground-truth run/ground_truth.tum --output run", "(--ground-truth)");
  ExpectRefused("report run --output run/stats.json", "(DIR)");
  ExpectRefused("online --thresholds run/thresholds.json --journal run/thresholds.json < g.g2o", "(--thresholds)");
  ExpectRefused("online --thresholds run/thresholds.json --journal run/decisions.csv --output run < g.g2o", "--output");
  fs::create_symlink("stats.json", Path("run/trajectory.svg"));
  ExpectRefused("plot run --what trajectory", "run/trajectory.svg is the same file as the input run/stats.json");
  EXPECT_EQ(Read("run/compact.g2o"), map);
  EXPECT_EQ(Read("run/stats.json"), stats);
  // A map goes on growing where it is.
  Succeed("compact g.g2o --continue run --output run --quiet");
}

TEST_F(OutputPaths, HelpIntoAFullDiskFails) {
  ASSERT_TRUE(fs::exists("/dev/full"));
  for (const char* arguments : {"--help", "--version", "solve --help", "generate stereo --help", "table --help",
                                "--print-man", "--print-completion"}) {
    const std::string line =
        std::string("'" TERSE_COMMAND "' ") + arguments + " > /dev/full 2> '" + Path("error") + "'";
    const int status = std::system(line.c_str());
    ASSERT_TRUE(WIFEXITED(status));
    EXPECT_EQ(WEXITSTATUS(status), 1) << arguments;
    EXPECT_NE(Read("error").find("terse: error: (standard output): cannot write: No space left on device"),
              std::string::npos)
        << Read("error");
    Succeed(arguments);
  }
}

}  // namespace
}  // namespace terse
