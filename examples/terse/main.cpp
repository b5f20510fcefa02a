// The terse command. Exit codes: 0 done, 1 bad input, 2 usage, 3 numerical failure, 130 interrupted.

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <iostream>
#include <new>
#include <stdexcept>

#include "commands/commands.h"
#include "commands/reference.h"
#include "commands/stereo_program.h"
#include "run/standard_output.h"
#include "terse/core/atomic_file.h"
#include "terse/core/freed_memory.h"

namespace {

extern "C" void RemoveFilesAndExit(int signal) {
  terse::RemoveUncommittedFiles();
  // A half-drawn progress line would stay behind.
  if (isatty(STDERR_FILENO) != 0 && write(STDERR_FILENO, "\r\033[K", 4) < 0) _exit(130);
  _exit(signal == SIGPIPE ? 128 + SIGPIPE : 130);
}

int Fail(const std::string& cause, int code) {
  std::cerr << "terse: error: " << cause << '\n';
  return code;
}

// The first argument that `app`, or the subcommand it belongs to, does not know, and what was probably meant.
std::string DescribeUnknown(CLI::App& app) {
  CLI::App* active = &app;
  while (!active->get_subcommands().empty()) active = active->get_subcommands().front();
  std::vector<std::string> unknown = active->remaining(true);
  // Options first: what follows an unknown option is its value, not a mistake of its own.
  std::stable_partition(unknown.begin(), unknown.end(), [](const std::string& text) { return text[0] == '-'; });
  if (unknown.empty()) return "";
  const std::string mistyped = unknown.front().substr(0, unknown.front().find('='));
  const bool is_option = mistyped[0] == '-';
  std::vector<std::string> names;
  if (is_option) {
    for (const CLI::Option* option : active->get_options()) {
      for (const std::string& name : option->get_lnames()) names.push_back("--" + name);
    }
  } else {
    for (const CLI::App* subcommand : active->get_subcommands({})) names.push_back(subcommand->get_name());
  }
  const std::string kind = is_option       ? "unknown option "
                           : names.empty() ? "unexpected argument "
                                           : "unknown subcommand ";
  const std::string nearest = terse::NearestName(mistyped, names);
  return kind + mistyped + (nearest.empty() ? "" : "; did you mean " + nearest + "?");
}

int Run(int argc, char** argv) {
  CLI::App app("Compact pose SLAM: pose graphs that keep only what carries information.", "terse");
  app.set_version_flag("--version", "terse " TERSE_VERSION);
  app.require_subcommand(1);
  app.footer(
      "Example: terse generate sphere --output sphere.g2o && terse info sphere.g2o\n"
      "Exit codes: 0 done, 1 bad input, 2 usage, 3 numerical failure");
  terse::AddInfoCommand(app);
  terse::AddSolveCommand(app);
  terse::AddCompactCommand(app);
  terse::AddSparsifyCommand(app);
  terse::AddMergeCommand(app);
  terse::AddOnlineCommand(app);
  terse::AddKittiCommand(app);
  terse::AddCovarianceCommand(app);
  terse::AddConvertCommand(app);
  terse::AddEvaluateCommand(app);
  terse::AddGenerateCommand(app);
  terse::AddTableCommand(app);
  terse::AddSweepCommand(app);
  terse::AddReportCommand(app);
  terse::AddPlotCommand(app);
  terse::AddReferenceOptions(app);
  for (CLI::App* command : app.get_subcommands({})) {  // but for one that goes on for days beside others
    if (command->get_name() != "online") command->preparse_callback([](std::size_t) { terse::KeepFreedMemory(); });
  }
  try {
    app.parse(argc, argv);
    return 0;
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) {  // --help, --version
      app.exit(error);
      terse::FlushOutput();
      return 0;
    }
    const std::string unknown = DescribeUnknown(app);
    Fail(unknown.empty() ? error.what() : unknown, 2);
    std::cerr << "Run with --help for more information.\n";
    return 2;
  }
}

// A file that is opened later must not become what the command prints to. What was closed stays unusable: these fail.
void OpenMissingDescriptors() {
  for (const int wanted : {STDIN_FILENO, STDOUT_FILENO, STDERR_FILENO}) {
    if (fcntl(wanted, F_GETFD) >= 0 || errno != EBADF) continue;
    if (open("/dev/null", wanted == STDIN_FILENO ? O_WRONLY : O_RDONLY) != wanted) _exit(1);
  }
}

}  // namespace

int main(int argc, char** argv) {
  OpenMissingDescriptors();
  for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE}) std::signal(signal, RemoveFilesAndExit);
  std::signal(SIGXFSZ, SIG_IGN);  // a file beyond `ulimit -f` is an error like a full disk
  std::ios::sync_with_stdio(false);
  try {
    return Run(argc, argv);
  } catch (const terse::StereoProgramAsked&) {
    return Fail(terse::RunStereoProgram(argv), 1);
  } catch (const terse::NumericalError& error) {
    return Fail(error.what(), 3);
  } catch (const std::bad_alloc&) {
    return Fail("out of memory", 1);
  } catch (const std::exception& error) {  // FileError, std::invalid_argument
    return Fail(error.what(), 1);
  }
}
