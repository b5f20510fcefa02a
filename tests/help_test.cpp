// What --help promises: every example in it works, what is mistyped is met with the nearest name, -v says what is done.

#include <gtest/gtest.h>

#include <algorithm>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "testing_command.h"

namespace {

namespace fs = std::filesystem;
using terse::testing::Outcome;

class Help : public terse::testing::CommandTest {
 protected:
  // "", "info", ..., "generate stereo", ...
  std::vector<std::string> AllSubcommands(const std::string& of = "") const {
    std::vector<std::string> all = {of};
    std::istringstream help(Succeed(of + " --help").out);
    bool is_listing = false;
    for (std::string line; std::getline(help, line);) {
      if (line == "Subcommands:") {
        is_listing = true;
      } else if (line.rfind("  ", 0) != 0) {
        is_listing = false;
      } else if (is_listing && line[2] != ' ') {
        const std::string name = line.substr(2, line.find(' ', 2) - 2);
        for (const std::string& below : AllSubcommands(of.empty() ? name : of + " " + name)) all.push_back(below);
      }
    }
    return all;
  }

  // The lines from "Example: " on that are indented like it.
  std::string ExampleOf(const std::string& subcommand) const {
    const std::string mark = "Example: ", indent(mark.size(), ' ');
    std::istringstream help(Succeed(subcommand + " --help").out);
    std::string script;
    for (std::string line; std::getline(help, line);) {
      if (line.rfind(mark, 0) == 0 || (!script.empty() && line.rfind(indent, 0) == 0)) {
        script += line.substr(mark.size()) + "\n";
      } else if (!script.empty()) {
        break;
      }
    }
    return script;
  }

  // What it wrote, or nullopt if it failed.
  std::optional<std::string> RunScript(const std::string& script, const fs::path& folder) const {
    fs::create_directories(folder);
    const std::string log = (folder_ / ".log").string();
    std::ofstream(folder_ / ".script") << "set -eu\nPATH='" << fs::path(TERSE_COMMAND).parent_path().string()
                                       << "':$PATH\ncd '" << folder.string() << "'\n"
                                       << script;
    const int status = std::system(("sh '" + (folder_ / ".script").string() + "' > '" + log + "' 2>&1").c_str());
    if (status == 0) return terse::testing::Slurp(log);
    last_failure_ = terse::testing::Slurp(log);
    return std::nullopt;
  }

  mutable std::string last_failure_;
};

// Each in a folder of its own; one that needs what others made, where all of them ran.
TEST_F(Help, EveryExampleWorks) {
  const std::vector<std::string> subcommands = AllSubcommands();
  EXPECT_GE(subcommands.size(), 14u);
  std::vector<std::pair<std::string, std::string>> dependent;
  std::set<std::string> seen;
  const fs::path all = folder_ / "all";
  for (const std::string& subcommand : subcommands) {
    const std::string script = ExampleOf(subcommand);
    EXPECT_NE(script, "") << subcommand << " --help has no example";
    if (!seen.insert(script).second) continue;  // a subcommand without an own one shows that of the command
    EXPECT_NE(script.find(subcommand.empty() ? "terse " : "terse " + subcommand), std::string::npos) << script;
    const fs::path own = folder_ / ("example " + subcommand);
    if (RunScript(script, own)) {
      fs::copy(own, all, fs::copy_options::recursive | fs::copy_options::overwrite_existing);
    } else {
      dependent.emplace_back(subcommand, script);
    }
  }
  for (const auto& [subcommand, script] : dependent) {
    EXPECT_TRUE(RunScript(script, all)) << subcommand << ":\n" << script << last_failure_;
  }
}

TEST_F(Help, SaysWhichStrategyIsTheDefault) {
  for (const std::string command : {"compact", "online"}) {
    const std::string help = Succeed(command + " --help").out;
    const std::size_t option = help.find("  --strategy ");
    ASSERT_NE(option, std::string::npos) << command;
    const std::string line = help.substr(option, help.find('\n', option) - option);
    EXPECT_NE(line.find("bounded=bounded"), std::string::npos) << line;
  }
}

TEST_F(Help, MistypedNamesAreMetWithTheNearest) {
  ExpectFailure("comapct x.g2o", 2, "unknown subcommand comapct; did you mean compact?");
  ExpectFailure("table igg-sop x", 2, "unknown subcommand igg-sop; did you mean igg-spo?");
  ExpectFailure("generate steroe", 2, "did you mean stereo?");
  ExpectFailure("generate shpere", 2, "did you mean sphere?");
  ExpectFailure("compact x.g2o --output o --strategy fpfk", 2,
                "fpfk not in {apal,apfl,fpfl,rfpfl,bounded}; did you mean fpfl?");
  ExpectFailure("solve x.g2o --robust hubert", 2, "did you mean huber?");
  ExpectFailure("solve x.g2o --mode=increment", 2, "did you mean incremental?");
  ExpectFailure("evaluate a b --align se4", 2, "did you mean se3?");
  ExpectFailure("solve x.g2o --polcy gn1", 2, "unknown option --polcy; did you mean --policy?");
  const Outcome far = Run("solve x.g2o --robust nothing-of-the-kind");
  EXPECT_EQ(far.exit_code, 2);
  EXPECT_EQ(far.err.find("did you mean"), std::string::npos) << far.err;
}

TEST_F(Help, VerboseSaysWhatIsDoneOnStandardError) {
  ASSERT_EQ(Run("generate ellipse --output e.g2o").exit_code, 0);
  const std::vector<std::pair<std::string, std::string>> runs = {
      {"solve e.g2o", "batch: converged"},
      {"solve e.g2o --mode incremental", "batch: converged"},
      {"covariance e.g2o --solve --ids 1", "batch: converged"},
      {"compact e.g2o --strategy fpfl --output few", "pose 0 kept, first"},
      {"sweep e.g2o --threshold pose --steps 1", "pose 0 kept, first"},
      {"online --range 10 10 10 1.5 < e.g2o", "pose 0 kept, first"},
  };
  for (const auto& [arguments, expected] : runs) {
    const std::size_t end = std::min(arguments.find(" <"), arguments.size());
    const auto with = [&, a = arguments](const std::string& more) {
      return Succeed(a.substr(0, end) + " " + more + a.substr(end));
    };
    const Outcome silent = with(""), info = with("-v"), everything = with("-vv");
    EXPECT_EQ(silent.err, "") << arguments;
    EXPECT_NE(info.err.find("terse: " + expected), std::string::npos) << arguments << '\n' << info.err;
    EXPECT_EQ(info.err.find("debug"), std::string::npos) << arguments;
    EXPECT_NE(everything.err.find("terse: debug: "), std::string::npos) << arguments;
    EXPECT_GT(everything.err.size(), info.err.size()) << arguments;
    const auto lines = [](const std::string& text) { return std::count(text.begin(), text.end(), '\n'); };
    EXPECT_EQ(lines(silent.out), lines(info.out)) << arguments;  // but for times the same
  }
  ExpectFailure("solve e.g2o -v --quiet", 2, "--quiet");
}

TEST_F(Help, ReferenceNamesEverySubcommand) {
  const std::string manual = Succeed("--print-man").out, completion = Succeed("--print-completion").out;
  for (const std::string& subcommand : AllSubcommands()) {
    if (subcommand.empty()) continue;
    const std::string heading = ".SS terse " + std::regex_replace(subcommand, std::regex("-"), "\\-") + "\n";
    EXPECT_NE(manual.find(heading), std::string::npos) << subcommand;
    EXPECT_NE(completion.find("'" + subcommand + "') path="), std::string::npos) << subcommand;
  }
  for (const char c : manual) EXPECT_TRUE(c == '\n' || (c >= ' ' && c <= '~')) << "not ASCII: " << static_cast<int>(c);
}

}  // namespace
