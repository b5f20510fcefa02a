#pragma once
// Messages about the course of the work, for people. The library is silent unless the options of what is used hold a
// sink; there is nothing global, and without a sink no message is built.
//
//   options.log = [](terse::LogLevel level, std::string_view text) { std::cerr << terse::Name(level) << text << '\n';
//   };
//
// A sink is called in the thread that called the library, between two steps of the work; it must not call the object
// that it hears from. What it throws is dropped: a message that gets lost ends no step and changes no state. Sinks are
// no part of a saved state (Load takes one). The text is one line without a line end; its wording may change.

#include <functional>
#include <string_view>

namespace terse {

enum class LogLevel {
  kWarning,  // went on, but not as it should: a lost frame, no convergence
  kInfo,     // what somebody who watches wants to know: beginning and end, links, what was refused
  kDebug,    // every pose, step and iteration
};
const char* Name(LogLevel level);

using LogSink = std::function<void(LogLevel level, std::string_view message)>;

}  // namespace terse
