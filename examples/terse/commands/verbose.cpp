#include "commands/verbose.h"

#include <unistd.h>

#include <iostream>
#include <string>

namespace terse {
namespace {

void Write(LogLevel level, std::string_view message) {
  // A progress line gives way; its next update draws it again below.
  static const bool is_terminal = isatty(STDERR_FILENO) == 1;
  std::string line = is_terminal ? "\r\033[K" : "";
  line += level == LogLevel::kInfo ? "terse: " : std::string("terse: ") + Name(level) + ": ";
  std::cerr << line.append(message).append("\n") << std::flush;
}

}  // namespace

void AddVerboseOption(CLI::App& subcommand, LogSink& log) {
  CLI::Option* verbose = subcommand.add_flag_function(
      "-v,--verbose",
      [&log](std::int64_t count) {
        const LogLevel most = count > 1 ? LogLevel::kDebug : LogLevel::kInfo;
        log = [most](LogLevel level, std::string_view message) {
          if (level <= most) Write(level, message);
        };
      },
      "Say on standard error what is done: links, refusals, iterations; -vv: everything");
  verbose->disable_flag_override();  // --verbose=abc would reach std::stoll
  if (CLI::Option* quiet = subcommand.get_option_no_throw("--quiet")) verbose->excludes(quiet);
}

}  // namespace terse
