#include "run/progress.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace terse {
namespace {

std::string Duration(double seconds) {
  const long s = static_cast<long>(seconds + 0.5);
  char text[32];
  if (s < 60) {
    std::snprintf(text, sizeof(text), "%ld s", s);
  } else if (s < 3600) {
    std::snprintf(text, sizeof(text), "%ld min %02ld s", s / 60, s % 60);
  } else {
    std::snprintf(text, sizeof(text), "%ld h %02ld min", s / 3600, s / 60 % 60);
  }
  return text;
}

}  // namespace

Progress::Progress(const std::string& label, long total, bool quiet)
    : label_(label),
      total_(total),
      quiet_(quiet),
      enabled_(!quiet && isatty(STDERR_FILENO) == 1),
      start_(Clock::now()) {
  next_ = start_ + std::chrono::milliseconds(200);  // what is over by then needs no line
}

Progress::~Progress() { Clear(); }

void Progress::Clear() {
  if (drawn_) std::fputs("\r\033[K", stderr);
  drawn_ = false;
}

void Progress::Restart(const std::string& label) {
  label_ = label;
  start_ = Clock::now();
}

void Progress::Say(const std::string& line) {
  if (quiet_) return;
  Clear();
  std::fprintf(stderr, "%s\n", line.c_str());
}

void Progress::Update(long done) {
  if (!enabled_) return;
  const Clock::time_point now = Clock::now();
  if (now < next_) return;
  next_ = now + std::chrono::milliseconds(100);
  drawn_ = true;
  const double elapsed_s = std::chrono::duration<double>(now - start_).count();
  const double rate = static_cast<double>(done) / elapsed_s;
  if (total_ <= 0) {
    std::fprintf(stderr, "\r%s %ld  %.4g/s\033[K", label_.c_str(), done, rate);
    return;
  }
  constexpr int kWidth = 30;
  const double fraction = std::min(1.0, static_cast<double>(done) / static_cast<double>(total_));
  const int filled = static_cast<int>(fraction * kWidth);
  const double left_s = rate > 0 ? static_cast<double>(std::max(0L, total_ - done)) / rate : 0;
  std::fprintf(stderr, "\r%s [%s%s] %ld/%ld  %.4g/s  %s left\033[K", label_.c_str(),
               std::string(static_cast<std::size_t>(filled), '#').c_str(),
               std::string(static_cast<std::size_t>(kWidth - filled), '.').c_str(), done, total_, rate,
               Duration(left_s).c_str());
}

void BatchProgress::UpdateFactor(double share) {
  if (share < share_) Restart();
  share_ = share;
  line_.Update(static_cast<long>(share * kWhole));
}

void BatchProgress::FinishStep(int iteration) {
  iteration_ = iteration;
  Restart();
}

void BatchProgress::Restart() {
  share_ = 0;
  line_.Restart(iteration_ == 0 ? "start, factorising"
                                : "iteration " + std::to_string(iteration_ + 1) + ", factorising");
}

}  // namespace terse
