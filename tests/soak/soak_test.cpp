// `terse online` over a long time: laps over known ground, late links, removals, questions, comments and bad lines.
// What keeps nothing costs no memory, a pose costs no more later than at first, and no descriptor stays open.
//
// TERSE_SOAK_SECONDS says how long (12 by default; `make soak SECONDS=3600`). A dropped pose keeps a record, by which
// it can be asked for and recovered, so memory is held against the poses seen.

#include <fcntl.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <condition_variable>
#include <cstring>
#include <iostream>
#include <mutex>
#include <random>
#include <set>

#include "../slow_build.h"
#include "../testing_command.h"

namespace terse {
namespace {

using Clock = std::chrono::steady_clock;

double SoakSeconds() {
  const char* text = std::getenv("TERSE_SOAK_SECONDS");
  return text == nullptr ? 12 : std::max(4.0, std::atof(text));
}

// The command with pipes on both sides; a thread reads what it answers.
class Online {
 public:
  Online(const std::vector<std::string>& arguments, const std::string& folder) {
    int in[2], out[2];
    if (pipe2(in, O_CLOEXEC) != 0 || pipe2(out, O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    child_ = fork();
    if (child_ == 0) {
      dup2(in[0], STDIN_FILENO);
      dup2(out[1], STDOUT_FILENO);
      std::vector<char*> argv{const_cast<char*>("terse"), const_cast<char*>("online")};
      for (const auto& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
      argv.push_back(nullptr);
      if (chdir(folder.c_str()) == 0) execv(TERSE_COMMAND, argv.data());
      _exit(127);
    }
    close(in[0]);
    close(out[1]);
    to_ = in[1];
    from_ = out[0];
    reader_ = std::thread([this] { Read(); });
  }
  ~Online() { Close(); }

  void Send(const std::string& text) {
    for (std::size_t done = 0; done < text.size();) {
      const ssize_t count = write(to_, text.data() + done, text.size() - done);
      if (count <= 0) throw std::runtime_error("the command does not read any more");
      done += static_cast<std::size_t>(count);
    }
  }
  // Until all that was sent is done: the answer to a question comes after those to the lines before it.
  void Settle(long pose) {
    Send("FLUSH\nCOVARIANCE " + std::to_string(pose) + "\n");
    Expect();
    std::unique_lock lock(mutex_);
    const auto is_done = [&] { return covariances_ >= asked_ || ended_; };
    if (!answered_.wait_for(lock, std::chrono::seconds(60), is_done)) throw std::runtime_error("no answer in a minute");
    if (ended_) throw std::runtime_error("the command has ended");
  }
  // Sent with the lines: one more answer to wait for.
  void Expect() { ++asked_; }

  // The factor of a link that was accepted, -1 if there is none since the last call.
  long TakeFactor() {
    const std::lock_guard lock(mutex_);
    return std::exchange(factor_, -1);
  }
  long Kept() const { return kept_; }
  long Errors() const { return errors_; }
  int Descriptors() const {
    int count = 0;
    for (const auto& entry : std::filesystem::directory_iterator("/proc/" + std::to_string(child_) + "/fd")) {
      count += entry.path().empty() ? 0 : 1;
    }
    return count;
  }
  double Megabytes() const {
    std::ifstream statm("/proc/" + std::to_string(child_) + "/statm");
    double pages = 0;
    statm >> pages >> pages;
    return pages * static_cast<double>(sysconf(_SC_PAGESIZE)) / 1e6;
  }
  // The exit status.
  int Close() {
    if (to_ < 0) return -1;
    close(std::exchange(to_, -1));
    reader_.join();
    close(from_);
    int status = 0;
    waitpid(child_, &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }

 private:
  void Read() {
    std::string rest;
    std::vector<char> block(1 << 16);
    for (ssize_t count = 0; (count = read(from_, block.data(), block.size())) > 0;) {
      rest.append(block.data(), static_cast<std::size_t>(count));
      std::size_t begin = 0;
      for (std::size_t end = 0; (end = rest.find('\n', begin)) != std::string::npos; begin = end + 1) {
        Take(nlohmann::json::parse(rest.substr(begin, end - begin)));
      }
      rest.erase(0, begin);
    }
    const std::lock_guard lock(mutex_);
    ended_ = true;
    answered_.notify_all();
  }
  void Take(const nlohmann::json& answer) {
    const std::lock_guard lock(mutex_);
    if (answer.contains("error")) ++errors_;
    if (answer.contains("covariance")) {
      ++covariances_;
      answered_.notify_all();
    } else if (answer.value("kept", false)) {
      ++kept_;
    }
    if (!answer.contains("links")) return;
    for (const auto& link : answer["links"]) {
      if (link.contains("factor") && link["factor"].is_number()) factor_ = link["factor"].get<long>();
    }
  }

  pid_t child_ = -1;
  int to_ = -1, from_ = -1;
  std::thread reader_;
  std::mutex mutex_;
  std::condition_variable answered_;
  long covariances_ = 0, asked_ = 0, factor_ = -1;
  std::atomic<long> kept_{0}, errors_{0};
  bool ended_ = false;
};

// A circle of so many poses, a metre apart; every pose of a later lap sees its place in the first.
constexpr int kLap = 100;

class Laps {
 public:
  // The lines of the next pose.
  std::string Next() {
    const double turn = 2 * 3.14159265358979 / kLap;
    const long k = ++newest_;
    std::string lines =
        Edge(k - 1, k, 1 + 0.02 * normal_(random_), 0.02 * normal_(random_), turn + 0.002 * normal_(random_));
    if (k >= kLap && k % 5 == 0)
      lines += Edge(k % kLap, k, 0.02 * normal_(random_), 0.02 * normal_(random_), 0.002 * normal_(random_));
    return lines;
  }
  long Newest() const { return newest_; }

 private:
  static std::string Edge(long from, long to, double x, double y, double theta) {
    std::ostringstream line;
    line << "EDGE_SE2 " << from << ' ' << to << ' ' << x << ' ' << y << ' ' << theta << " 2500 0 0 2500 0 250000\n";
    return line.str();
  }
  std::mt19937 random_{1};
  std::normal_distribution<double> normal_;
  long newest_ = 0;
};

class Soak : public testing::CommandTest {};

// A hundred poses, with everything else between them.
void SendPoses(Online& online, Laps& laps) {
  for (int k = 0; k < 100; ++k) {
    online.Send(laps.Next());
    const long pose = laps.Newest();
    if (k % 10 == 3) online.Send("# a comment\n\n");
    if (k % 10 == 5) online.Send("EDGE_SE2 " + std::to_string(pose) + " 0 nan 0 0 1 0 0 1 0 1\nNONSENSE 1 2 3\n");
    if (k % 20 == 7) {
      online.Send("FLUSH\nCOVARIANCE 0 " + std::to_string(pose) + "\n");
      online.Expect();
    }
    if (k % 50 == 9) {
      const long factor = online.TakeFactor();
      if (factor >= 0) online.Send("REMOVE " + std::to_string(factor) + "\n");
    }
  }
}

// Returns how many lines there were; none of them keeps anything.
long SendWhatKeepsNothing(Online& online) {
  long lines = 0;
  for (int k = 0; k < 50; ++k) {
    online.Send(
        "# nothing\nEDGE_SE2 0 1 1\nREMOVE 99999999\nREMOVE x\nCOVARIANCE 99999999\nVERTEX_SE2 1 2\nFIX "
        "a\n\nCOVARIANCE " +
        std::to_string(k) + " " + std::to_string(k + 1) + "\n");
    online.Expect();
    lines += 9;
  }
  return lines;
}

TEST_F(Soak, MemoryAndDescriptorsStayFlat) {
  const double seconds = SoakSeconds();
  Online online({"--range", "3", "3", "1", "--min-pose-gain", "6", "--min-loop-gain", "5", "--journal", "journal"},
                folder_.string());
  struct Sample {
    double megabytes;
    long poses, kept;
  };
  std::vector<Sample> samples;
  std::set<int> descriptors;
  Laps laps;
  const auto start = Clock::now();
  const auto elapsed = [&] { return std::chrono::duration<double>(Clock::now() - start).count(); };
  const auto sample = [&] {
    online.Settle(laps.Newest());
    samples.push_back({online.Megabytes(), laps.Newest(), online.Kept()});
    descriptors.insert(online.Descriptors());
  };
  // At most 400 poses a second, so that an hour fits into memory.
  const double half = seconds / 2;
  while (elapsed() < half) {
    SendPoses(online, laps);
    sample();
    const double ahead = static_cast<double>(laps.Newest()) / 400 - elapsed();
    if (ahead > 0) std::this_thread::sleep_for(std::chrono::duration<double>(ahead));
  }
  ASSERT_GE(samples.size(), 8u) << "too slow to tell";
  // What is held: a look at what was measured so far makes another map beside the one in use, and is over after fewer
  // poses than a quarter of them. From the second quarter on, by then buffers have found their size.
  const std::size_t quarter = samples.size() / 4;
  const auto least = [&](std::size_t begin, std::size_t end) {
    const auto at = [&](std::size_t k) { return samples.begin() + static_cast<std::ptrdiff_t>(k); };
    return *std::min_element(at(begin), at(end), [](auto& a, auto& b) { return a.megabytes < b.megabytes; });
  };
  const Sample early = least(quarter, 2 * quarter), late = least(samples.size() - quarter, samples.size());
  const double per_pose = (late.megabytes - early.megabytes) * 1e6 / static_cast<double>(late.poses - early.poses);
  std::cout << samples.back().poses << " poses, " << samples.back().kept << " kept; " << early.megabytes << " MB at "
            << early.poses << ", " << late.megabytes << " at " << late.poses << ": " << per_pose << " bytes a pose\n";

  // Only what keeps nothing.
  const double before = late.megabytes;
  const long errors = online.Errors();
  long lines = 0;
  while (elapsed() < seconds) {
    lines += SendWhatKeepsNothing(online);
    sample();
  }
  std::cout << lines << " lines that keep nothing: " << before << " to " << samples.back().megabytes << " MB; "
            << *descriptors.begin() << " descriptors\n";
  EXPECT_GE(online.Errors(), errors + lines / 9 * 6);
  EXPECT_EQ(samples.back().poses, laps.Newest());
  EXPECT_EQ(descriptors.size(), 1u) << "from " << *descriptors.begin() << " to " << *descriptors.rbegin();
  if (!kSlowBuild) {  // a sanitizer keeps what was freed
    EXPECT_LT(per_pose, 4000);
    EXPECT_LT(samples.back().megabytes, before + 2);
  }
  EXPECT_EQ(online.Close(), 0);
}

}  // namespace
}  // namespace terse
