#include "terse/core/log.h"

namespace terse {

const char* Name(LogLevel level) {
  switch (level) {
    case LogLevel::kWarning: return "warning";
    case LogLevel::kInfo: return "info";
    case LogLevel::kDebug: return "debug";
  }
  return "unknown";
}

}  // namespace terse
