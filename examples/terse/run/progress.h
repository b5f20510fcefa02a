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
  // Counts from here on, under this label.
  void Restart(const std::string& label);

 private:
  using Clock = std::chrono::steady_clock;
  std::string label_;
  long total_;
  bool quiet_, enabled_;
  bool drawn_ = false;
  Clock::time_point start_, next_;
};

// Of a batch optimisation: at which step it is, how far with a factorisation and when that is done. How many steps come
// nobody knows.
class BatchProgress {
 public:
  explicit BatchProgress(bool quiet) : line_("start, factorising", kWhole, quiet) {}
  // For BatchOptions::factor_progress and progress.
  void UpdateFactor(double share);
  void FinishStep(int iteration);
  void Clear() { line_.Clear(); }

 private:
  static constexpr long kWhole = 100;  // per cent
  void Restart();

  Progress line_;
  int iteration_ = 0;
  double share_ = 0;
};

}  // namespace terse
