#pragma once
// A progress line on standard error: bar, count, rate and time left.

#include <chrono>
#include <string>

namespace terse {

// Draws only when standard error is a terminal and `quiet` is false, at most ten times a second. The destructor
// clears the line.
class Progress {
 public:
  // `total` 0: unknown, so neither bar nor time left.
  Progress(const std::string& label, long total, bool quiet);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;
  void Update(long done);
  // A whole line of text that stays, above the progress line; unless quiet, also where there is no terminal.
  void Say(const std::string& line);
  // Takes the line away until the next update, for what goes to standard output.
  void Clear();

 private:
  using Clock = std::chrono::steady_clock;
  std::string label_;
  long total_;
  bool quiet_, enabled_;
  bool drawn_ = false;
  Clock::time_point start_, next_;
};

}  // namespace terse
