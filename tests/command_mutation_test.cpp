// The whole command on damaged files of every kind: it does its work or says "terse: error: ...", whatever is in them.
// No signal, no hang, no report of a sanitizer.

#include <gtest/gtest.h>

#include <random>

#include "slow_build.h"
#include "testing_command.h"
#include "text_mutator.h"

namespace terse {
namespace {

using testing::Outcome;

constexpr int kRounds = kSlowBuild ? 2 : 4;  // of all commands

class CommandMutation : public testing::CommandTest {
 protected:
  void SetUp() override {
    CommandTest::SetUp();
    Succeed("generate ellipse-n --laps 1 --seed 3 --output plane.all --ground-truth true.tum");
    Succeed("generate sphere --poses 60 --seed 3 --output space.g2o");
    Write("plane.g2o", Head(Read("plane.all"), 60));
    Write("ellipse.g2o", Head(testing::Slurp(TERSE_SOURCE_DIR "/data/ellipse.g2o"), 80));
    Succeed("convert space.g2o space.graph");
    Succeed("convert plane.g2o plane.graph");
    Succeed("convert space.g2o space.tum");
    Succeed("convert space.g2o space.kitti");
    Succeed("compact space.g2o --strategy fpfl --range 5 5 5 1.5 --quiet --output run");
    Succeed("solve plane.g2o --output priors.g2o --quiet");
    Write("priors.g2o",
          Read("priors.g2o") + "EDGE_PRIOR_SE2_XY 3 1 2 4 0 4\nFIX 0\nEDGE_PRIOR_SE2 5 1 2 0 4 0 0 4 0 4\n");
  }
  static std::string Head(const std::string& text, int lines) {
    std::size_t end = 0;
    for (; lines > 0 && end < text.size(); --lines) end = std::min(text.find('\n', end), text.size() - 1) + 1;
    return text.substr(0, end);
  }
  // One to four changes.
  std::string Damaged(const std::string& name) {
    std::string text = Read(name);
    for (auto changes = 1 + random_() % 4; changes > 0; --changes) text = fuzz::MutateText(std::move(text), random_);
    return text;
  }
  void ExpectAnswer(const std::string& arguments, const std::string& damaged) const {
    const Outcome outcome = Run("--version > .version; timeout 60 '" TERSE_COMMAND "' " + arguments);
    const auto says = [&](const char* text) { return outcome.err.find(text) != std::string::npos; };
    const bool answered =
        outcome.exit_code == 0 || outcome.err.rfind("terse: error: ", 0) == 0 || says("\nterse: error: ");
    const bool good = outcome.exit_code >= 0 && outcome.exit_code <= 3 && answered && !says("Sanitizer") &&
                      !says("runtime error") && !says("Assertion");
    EXPECT_TRUE(good) << arguments << "\nexit code " << outcome.exit_code << '\n' << outcome.err << "of " << damaged;
  }
  void ExpectAnswers(const std::vector<std::string>& sources, const std::vector<std::string>& commands) {
    for (int round = 0; round < kRounds; ++round) {
      for (const std::string& command : commands) {
        const std::string& source = sources[random_() % sources.size()];
        const std::string text = Damaged(source), name = "damaged" + std::filesystem::path(source).extension().string();
        Write(name, text);
        std::string arguments = command;
        for (std::size_t at; (at = arguments.find('@')) != std::string::npos;) arguments.replace(at, 1, name);
        ExpectAnswer(arguments, source + ":\n" + text.substr(0, 20000));
      }
    }
  }
  // --gtest_random_seed=N draws others.
  std::mt19937_64 random_{20261122 + static_cast<std::uint64_t>(GTEST_FLAG_GET(random_seed))};
};

TEST_F(CommandMutation, Graphs) {
  ExpectAnswers(
      {"plane.g2o", "space.g2o", "ellipse.g2o", "priors.g2o", "plane.graph", "space.graph"},
      {"info @", "info @ --json --repair-information", "solve @ --output out.g2o --trajectory out.tum",
       "solve @ --mode incremental --repair-information --steps steps.csv --quiet",
       "solve @ --robust gnc --initial chordal --stats stats.json", "covariance @", "covariance @ --json --solve",
       "convert @ out.tum", "convert @ out.g2o", "convert @ out.graph", "evaluate @ space.tum --kitti",
       "compact @ --strategy apal --output new --quiet", "compact @ --auto-thresholds --output new --quiet",
       "compact @ --strategy fpfl --range 3 3 1.5 --output new --quiet"});
}

TEST_F(CommandMutation, Trajectories) {
  ExpectAnswers({"space.tum", "space.kitti", "true.tum"},
                {"evaluate @ space.tum", "evaluate space.kitti @ --kitti --json", "convert @ out.kitti",
                 "compact space.g2o --strategy apal --ground-truth @ --output new --quiet"});
}

TEST_F(CommandMutation, Streams) {
  ExpectAnswers({"plane.g2o", "space.g2o", "priors.g2o"},
                {"online --dimension 2 --range 3 3 1.5 --output new < @", "online --range 5 5 5 1.5 --covariances < @",
                 "online --strategy apal --robust huber --strict < @",
                 "online --range 3 3 3 1.5 --repair-information --no-innovation-test < @"});
  ExpectAnswers({"run/thresholds.json"},
                {"online --thresholds @ < space.g2o", "compact space.g2o --thresholds @ --output new"});
}

TEST_F(CommandMutation, Runs) {
  for (int round = 0; round < kRounds; ++round) {
    for (const std::string file : {"graph.json", "thresholds.json", "stats.json", "trajectory.tum", "decisions.jsonl",
                                   "decisions.csv", "steps.csv", "covariances.csv", "compact.g2o"}) {
      const std::string whole = Read("run/" + file), text = Damaged("run/" + file);
      Write("run/" + file, text);
      for (const std::string command : {"report run --output page.html", "plot run --output picture",
                                        "compact space.g2o --continue run --output new"}) {
        ExpectAnswer(command, file + ":\n" + text.substr(0, 20000));
      }
      Write("run/" + file, whole);
    }
  }
}

}  // namespace
}  // namespace terse
