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

 private:
  using Clock = std::chrono::steady_clock;
  std::string label_;
  long total_;
  bool enabled_;
  bool drawn_ = false;
  Clock::time_point start_, next_;
};

}  // namespace terse
