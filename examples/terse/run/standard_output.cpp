#include "run/standard_output.h"

#include <cerrno>
#include <iostream>

#include "terse/core/descriptor.h"
#include "terse/core/error.h"

namespace terse {

void FlushOutput() {
  if (std::cout) errno = 0;  // else it tells why an earlier write failed
  if (std::cout.flush()) return;
  throw FileError("(standard output)", 0, "cannot write" + (errno != 0 ? ": " + SystemReason(errno) : ""));
}

void PrintJson(const nlohmann::ordered_json& json) {
  std::cout << json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
  FlushOutput();
}

}  // namespace terse
