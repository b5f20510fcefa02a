#pragma once
// Runs the built terse command as a user would. Needs TERSE_COMMAND, the path of the program.

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

namespace terse::testing {

struct Outcome {
  int exit_code = -1;
  std::string out, err;
};

inline std::string Slurp(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

// Each test works in a folder of its own, removed afterwards.
class CommandTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (std::filesystem::temp_directory_path() / "terse_command_XXXXXX").string();
    ASSERT_NE(mkdtemp(name.data()), nullptr);
    folder_ = name;
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  // `arguments` go through the shell, run in the test's folder.
  Outcome Run(const std::string& arguments) const {
    const std::string line = "cd '" + folder_.string() + "' && '" TERSE_COMMAND "' " + arguments + " > .out 2> .err";
    const int status = std::system(line.c_str());
    return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, Slurp(folder_ / ".out"), Slurp(folder_ / ".err")};
  }
  // Runs what must succeed.
  Outcome Succeed(const std::string& arguments) const {
    const Outcome outcome = Run(arguments);
    EXPECT_EQ(outcome.exit_code, 0) << arguments << '\n' << outcome.err;
    return outcome;
  }
  nlohmann::json Json(const std::string& arguments) const { return nlohmann::json::parse(Succeed(arguments).out); }
  nlohmann::json JsonFile(const std::string& name) const { return nlohmann::json::parse(Read(name)); }
  std::string Path(const std::string& name) const { return (folder_ / name).string(); }
  void Write(const std::string& name, const std::string& text) const { std::ofstream(folder_ / name) << text; }
  std::string Read(const std::string& name) const { return Slurp(folder_ / name); }
  bool Exists(const std::string& name) const { return std::filesystem::exists(folder_ / name); }
  void ExpectFailure(const std::string& arguments, int exit_code, const std::string& cause) const {
    const Outcome outcome = Run(arguments);
    EXPECT_EQ(outcome.exit_code, exit_code) << arguments << '\n' << outcome.err;
    EXPECT_EQ(outcome.err.rfind("terse: error: ", 0), 0u) << outcome.err;
    EXPECT_NE(outcome.err.find(cause), std::string::npos) << arguments << '\n' << outcome.err;
    EXPECT_EQ(outcome.out, "") << arguments;
  }
  // Files other than the captured output.
  long FileCount() const {
    long count = 0;
    for (const auto& entry : std::filesystem::directory_iterator(folder_)) {
      count += entry.path().filename().string()[0] != '.';
    }
    return count;
  }

  // Starts the command in the test's folder, sends the signal as soon as it could take one and `ready`, and
  // expects exit code 130.
  void Interrupt(const std::vector<std::string>& arguments, int signal, const std::function<bool()>& ready) const {
    std::vector<char*> argv{const_cast<char*>("terse")};
    for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
    argv.push_back(nullptr);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      if (chdir(folder_.c_str()) == 0) execv(TERSE_COMMAND, argv.data());
      _exit(127);
    }
    int status = 0;
    while (!Catches(child, signal) || !ready()) {
      ASSERT_EQ(waitpid(child, &status, WNOHANG), 0) << "it ended before it could be interrupted";
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
    kill(child, signal);
    ASSERT_EQ(waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status));
    EXPECT_EQ(WEXITSTATUS(status), 130);
  }

  std::filesystem::path folder_;

 private:
  // Whether the process has installed its handler yet; true where there is no /proc to tell.
  static bool Catches(pid_t process, int signal) {
    std::ifstream status("/proc/" + std::to_string(process) + "/status");
    for (std::string word; status >> word;) {
      if (word == "SigCgt:" && status >> word) return (std::stoull(word, nullptr, 16) >> (signal - 1) & 1) != 0;
    }
    return true;
  }
};

// Becomes true some time after it was first asked.
class After {
 public:
  explicit After(std::chrono::milliseconds wait) : wait_(wait) {}
  bool operator()() {
    const auto now = std::chrono::steady_clock::now();
    if (!start_) start_ = now;
    return now - *start_ >= wait_;
  }

 private:
  std::chrono::milliseconds wait_;
  std::optional<std::chrono::steady_clock::time_point> start_;
};

// The rows of a CSV file without the header, split at the commas.
inline std::vector<std::vector<std::string>> CsvRows(const std::string& text) {
  std::vector<std::vector<std::string>> rows;
  std::istringstream lines(text);
  std::string line, cell;
  std::getline(lines, line);
  while (std::getline(lines, line)) {
    rows.emplace_back();
    std::istringstream cells(line);
    while (std::getline(cells, cell, ',')) rows.back().push_back(cell);
    if (!line.empty() && line.back() == ',') rows.back().emplace_back();
  }
  return rows;
}

}  // namespace terse::testing
