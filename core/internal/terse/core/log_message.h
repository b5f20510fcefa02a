#pragma once
// How this library writes to a sink (log.h).

#include <sstream>

#include "terse/core/log.h"

namespace terse::internal {

// The parts one after the other, numbers with six digits.
template <class... Parts>
void Log(const LogSink& sink, LogLevel level, const Parts&... parts) noexcept {
  if (!sink) return;
  try {
    std::ostringstream text;
    (text << ... << parts);
    sink(level, text.str());
  } catch (...) {  // as log.h promises
  }
}

}  // namespace terse::internal
