// Short writes, full disks, I/O errors, interrupted calls and kills at every write of the journal, of an export and of
// a saved state: nothing acknowledged is lost, no file is half there, and no error is kept from the user.

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "terse/compact/compact_pose_slam.h"
#include "terse/core/error.h"
#include "testing_command.h"

namespace {

using nlohmann::json;
namespace fs = std::filesystem;

class FaultTest : public terse::testing::CommandTest {
 protected:
  struct Result {
    int exit_code = -1;  // -1: killed
    std::string out, err;
  };
  // `fault` as in faults.cpp; "" for none.
  Result RunWith(const std::string& fault, const std::string& command) const {
    const std::string line = "cd '" + folder_.string() + "' && TERSE_FAULT_COUNT=count TERSE_FAULT=" + fault +
                             " LD_PRELOAD='" TERSE_FAULTS "' " + command + " > .out 2> .err";
    const int status = std::system(line.c_str());
    const int code = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    return {code == 128 + SIGKILL ? -1 : code, Read(".out"), Read(".err")};
  }
  // How many calls of the command can be hit.
  int CountCalls(const std::string& command) const {
    EXPECT_EQ(RunWith("", command).exit_code, 0) << Read(".err");
    return std::stoi(Read("count"));
  }
  // And how many reads, after CountCalls.
  int CountedReads() const {
    const std::string counts = Read("count");
    return std::stoi(counts.substr(counts.find(' ')));
  }
  std::map<std::string, std::string> Files(const std::string& name) const {
    std::map<std::string, std::string> out;
    if (!Exists(name)) return out;
    for (const auto& entry : fs::directory_iterator(Path(name))) {
      out[entry.path().filename().string()] = terse::testing::Slurp(entry.path());
    }
    return out;
  }
  static std::string Describe(const std::string& fault, const Result& result) {
    return fault + ": exit " + std::to_string(result.exit_code) + ", " + result.err;
  }
  // An error is told with its reason, and the command says so by its exit code.
  static void ExpectSaysSo(const std::string& fault, const Result& result) {
    EXPECT_EQ(result.exit_code, 1) << Describe(fault, result);
    const bool is_full = fault.rfind("full", 0) == 0;
    EXPECT_NE(result.err.find(is_full ? "No space left on device" : "Input/output error"), std::string::npos)
        << Describe(fault, result);
  }
  static std::string At(const char* action, int call) { return std::string(action) + ':' + std::to_string(call); }
};

const std::string kCommand = "'" TERSE_COMMAND "' ";

class JournalFault : public FaultTest {
 protected:
  void SetUp() override {
    FaultTest::SetUp();
    std::string graph = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 100\n";
    for (int k = 2; k < 10; ++k) {
      const std::string id = std::to_string(k);
      graph += "EDGE_SE2 " + std::to_string(k - 1) + ' ' + id + " 1 0.1 0.6 100 0 0 100 0 100\n";
      if (k % 3 == 0) graph += "EDGE_SE2 " + std::to_string(k - 3) + ' ' + id + " 0.9 1.7 1.8 100 0 0 100 0 100\n";
    }
    std::istringstream text(graph);
    for (std::string line; std::getline(text, line);) lines_.push_back(line);
    Write("input", graph);
    whole_ = Answers(RunWith("", Online("journal", "whole")).out);
    whole_journal_ = Read("journal");
    calls_ = CountCalls(Online("counted", "counted_out"));
    EXPECT_GT(calls_, 30);
    EXPECT_GT(whole_.size(), 5u);
  }
  static std::string Online(const std::string& journal, const std::string& output, const std::string& input = "input") {
    return kCommand + "online --range 3 3 1.5 --min-loop-gain 0.1 --remember all --journal " + journal +
           (output.empty() ? "" : " --output " + output) + " < " + input;
  }
  // Decisions by pose.
  static std::map<int, json> Answers(const std::string& text) {
    std::map<int, json> out;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
      json answer = json::parse(line, nullptr, false);
      if (!answer.is_object() || !answer.contains("pose")) continue;  // the last one may be torn
      answer.erase("seconds");
      out[answer["pose"]] = answer;
    }
    return out;
  }
  // What was answered is in the journal, and the rest of the lines leads to the same end.
  void ExpectNothingLost(const std::string& fault, const Result& result) const {
    const std::map<int, json> answered = Answers(result.out);
    for (const auto& [pose, answer] : answered) EXPECT_EQ(answer, whole_.at(pose)) << fault;
    std::size_t taken = 0;
    if (Exists("hit") && !Read("hit").empty()) {
      const Result resumed = RunWith("", Online("hit", "", "/dev/null"));
      ASSERT_EQ(resumed.exit_code, 0) << Describe(fault, resumed);
      const json first = json::parse(resumed.out.substr(0, resumed.out.find('\n')), nullptr, false);
      if (first.is_object()) taken = first.at("lines");  // none where it was killed before it began
      // The end of this input closed the last pose: that is none of the lines.
      Write("hit", KeepLines(Read("hit"), taken));
    }
    if (!answered.empty()) {
      // A pose is decided on by the line after its last.
      EXPECT_GE(taken, static_cast<std::size_t>(answered.rbegin()->first)) << fault;
    }
    std::string rest;
    for (std::size_t k = taken; k < lines_.size(); ++k) rest += lines_[k] + '\n';
    Write("rest", rest);
    const Result finished = RunWith("", Online("hit", "pieces", "rest"));
    ASSERT_EQ(finished.exit_code, 0) << Describe(fault, finished);
    EXPECT_EQ(Files("pieces"), Files("whole")) << fault;
    EXPECT_EQ(Read("hit"), whole_journal_) << fault;
  }
  // Format, header and so many lines of a journal.
  static std::string KeepLines(const std::string& journal, std::size_t count) {
    std::size_t end = 0;
    for (std::size_t k = 0; k < count + 2; ++k) end = journal.find('\n', end) + 1;
    return journal.substr(0, end);
  }
  void Hit(const std::string& fault) {
    for (const char* name : {"hit", "hit_out", "pieces"}) fs::remove_all(Path(name));
    last_ = RunWith(fault, Online("hit", "hit_out"));
  }

  std::vector<std::string> lines_;
  std::map<int, json> whole_;
  std::string whole_journal_;
  int calls_ = 0;
  Result last_;
};

TEST_F(JournalFault, AKillAtAnyCallLosesNothingAcknowledged) {
  for (int call = 1; call <= calls_; ++call) {
    const std::string fault = At("kill", call);
    Hit(fault);
    EXPECT_EQ(last_.exit_code, -1) << Describe(fault, last_);
    ExpectNothingLost(fault, last_);
  }
}

TEST_F(JournalFault, AFullDiskOrABrokenOneStopsTheRunAndLosesNothing) {
  for (const char* action : {"full", "io"}) {
    for (int call = 1; call <= calls_; ++call) {
      const std::string fault = At(action, call);
      Hit(fault);
      if (last_.exit_code != 0) ExpectSaysSo(fault, last_);
      // What failed without a consequence: the removal of a temporary, a call after the last one that counts.
      if (last_.exit_code == 0) {
        EXPECT_EQ(Files("hit_out"), Files("whole")) << fault;
      }
      ExpectNothingLost(fault, last_);
    }
  }
}

TEST_F(JournalFault, ShortAndInterruptedCallsAreGoneOnWith) {
  for (const char* action : {"short", "intr"}) {
    for (int call = 1; call <= calls_; ++call) {
      const std::string fault = At(action, call);
      Hit(fault);
      EXPECT_EQ(last_.exit_code, 0) << Describe(fault, last_);
      EXPECT_EQ(Read("hit"), whole_journal_) << fault;
      EXPECT_EQ(Files("hit_out"), Files("whole")) << fault;
    }
  }
}

// An export: each file is the old one or the new one, and no temporary outlives the next run.
class ExportFault : public FaultTest {
 protected:
  void ExpectWholeFiles(const std::string& options_of_old, const std::string& options_of_new) {
    ASSERT_EQ(RunWith("", kCommand + "generate ellipse --poses 40 --quiet --output graph.g2o").exit_code, 0);
    const std::string command = kCommand + "compact graph.g2o --quiet --output out ";
    ASSERT_EQ(RunWith("", command + options_of_old).exit_code, 0) << Read(".err");
    const auto old_files = Files("out");
    fs::rename(Path("out"), Path("old"));
    const int calls = CountCalls(command + options_of_new);
    const auto new_files = Files("out");
    ASSERT_GT(new_files.size(), 4u);
    for (const char* action : {"kill", "full", "io", "short", "intr"}) {
      for (int call = 1; call <= calls; ++call) {
        const std::string fault = At(action, call);
        fs::remove_all(Path("out"));
        fs::copy(Path("old"), Path("out"), fs::copy_options::recursive);
        const Result result = RunWith(fault, command + options_of_new);
        if (action == std::string("kill")) {
          EXPECT_EQ(result.exit_code, -1) << Describe(fault, result);
        }
        if (action == std::string("short") || action == std::string("intr")) {
          EXPECT_EQ(result.exit_code, 0) << Describe(fault, result);
        }
        if (result.exit_code > 0) ExpectSaysSo(fault, result);
        for (const auto& [name, content] : Files("out")) {
          if (name.find(".tmp-") != std::string::npos) {
            EXPECT_TRUE(action == std::string("kill") || action == std::string("io")) << fault << ": " << name;
            continue;
          }
          EXPECT_TRUE(Same(name, content, old_files) || Same(name, content, new_files)) << fault << ": " << name;
        }
        if (result.exit_code == 0) ExpectSameFiles(new_files, fault);
      }
    }
    ASSERT_EQ(RunWith("", command + options_of_new).exit_code, 0);
    ExpectSameFiles(new_files, "after all");
  }

 private:
  // Times differ from run to run.
  static bool Same(const std::string& name, const std::string& content,
                   const std::map<std::string, std::string>& files) {
    const auto it = files.find(name);
    if (it == files.end()) return false;
    if (!HasTimes(name)) return it->second == content;
    const auto lines = [](const std::string& text) { return std::count(text.begin(), text.end(), '\n'); };
    return lines(content) == lines(it->second) && content.back() == it->second.back();
  }
  static bool HasTimes(const std::string& name) {
    return std::set<std::string>{"stats.json", "steps.csv", "report.html", "decisions.jsonl"}.count(name) != 0;
  }
  void ExpectSameFiles(const std::map<std::string, std::string>& expected, const std::string& fault) const {
    const auto files = Files("out");
    for (const auto& [name, content] : files) EXPECT_TRUE(Same(name, content, expected)) << fault << ": " << name;
    EXPECT_GE(files.size(), expected.size()) << fault;
  }
};

TEST_F(ExportFault, FilesAreOldOrNewAtEveryCall) { ExpectWholeFiles("--min-loop-gain 9", ""); }

// A saved state, as example 05 writes it.
TEST_F(FaultTest, ASavedStateIsTheOldOneOrTheNewOne) {
  using Slam = terse::CompactPoseSlam<terse::SE2>;
  terse::CompactOptions<terse::SE2> options;
  Slam small(options);
  terse::CompactInput<terse::SE2> first;
  first.id = {77};
  small.AddPose(first);
  small.Save(Path("old"));
  const std::string command = "'" TERSE_EXAMPLE "' state";
  const int calls = CountCalls(command);
  const std::string old_state = Read("old");
  for (const char* action : {"kill", "full", "io", "short", "intr"}) {
    for (int call = 1; call <= calls; ++call) {
      const std::string fault = At(action, call);
      Write("state", old_state);
      const Result result = RunWith(fault, command);
      const int seen = Slam::Load(Path("state")).PosesSeen();
      EXPECT_TRUE(seen == 1 || seen == 200) << fault;
      if (action == std::string("short") || action == std::string("intr")) {
        EXPECT_EQ(result.exit_code, 0) << Describe(fault, result);
        EXPECT_EQ(seen, 200) << fault;
      }
      if (result.exit_code > 0) {
        ExpectSaysSo(fault, result);
        EXPECT_EQ(seen, 1) << fault;
      }
    }
  }
}

TEST_F(JournalFault, ReadsThatFailAreToldAndOthersGoneOnWith) {
  // The lines come from the journal and from standard input.
  const std::size_t half = lines_.size() / 2;
  std::string rest;
  for (std::size_t k = half; k < lines_.size(); ++k) rest += lines_[k] + '\n';
  Write("rest", rest);
  const std::string begun = KeepLines(whole_journal_, half);
  Write("hit", begun);
  CountCalls(Online("hit", "hit_out", "rest"));
  const int reads = CountedReads();
  ASSERT_GT(reads, 3);
  int failed = 0;
  for (const char* action : {"read-io", "read-intr", "read-short"}) {
    for (int call = 1; call <= reads; ++call) {
      const std::string fault = At(action, call);
      fs::remove_all(Path("hit_out"));
      Write("hit", begun);
      const Result result = RunWith(fault, Online("hit", "hit_out", "rest"));
      if (action == std::string("read-io") && result.exit_code != 0) {
        ExpectSaysSo(fault, result);
        EXPECT_EQ(Read("hit").rfind(begun, 0), 0u) << fault;
        ++failed;
        continue;
      }
      EXPECT_EQ(result.exit_code, 0) << Describe(fault, result);
      EXPECT_EQ(Files("hit_out"), Files("whole")) << fault;
    }
  }
  EXPECT_GE(failed, 2);
}

TEST_F(FaultTest, FilesThatCannotBeReadAreNamed) {
  const std::string command = kCommand + "compact '" TERSE_SOURCE_DIR "/data/ellipse.g2o' --quiet --output out";
  ASSERT_EQ(RunWith("", command).exit_code, 0);
  const auto whole = Files("out");
  for (const std::string& reading :
       {kCommand + "info out/compact.g2o --json", kCommand + "evaluate out/trajectory.tum out/trajectory.tum --json",
        kCommand + "report out --output made/page.html", kCommand + "plot out --output made"}) {
    fs::remove_all(Path("made"));
    fs::create_directory(Path("made"));
    CountCalls(reading);
    const std::string expected = RunWith("", reading).out;
    const auto expected_files = Files("made");
    const int reads = CountedReads();
    EXPECT_GT(reads, 1) << reading;
    int failed = 0;
    for (const char* action : {"read-io", "read-intr", "read-short"}) {
      for (int call = 1; call <= reads; ++call) {
        const std::string fault = At(action, call);
        for (const auto& file : expected_files) fs::remove(Path("made/" + file.first));
        const Result result = RunWith(fault, reading);
        if (action == std::string("read-io") && result.exit_code != 0) {
          ExpectSaysSo(fault, result);
          ++failed;
        } else {
          EXPECT_EQ(result.exit_code, 0) << Describe(fault, result) << reading;
          EXPECT_EQ(result.out, expected) << fault;
          EXPECT_TRUE(Files("made") == expected_files) << fault << " " << reading;
        }
      }
    }
    EXPECT_GE(failed, 1) << reading;
  }
  EXPECT_EQ(Files("out"), whole);
}

}  // namespace
