#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <iostream>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "pictures/run_report.h"
#include "run/standard_output.h"

namespace terse {
namespace {

struct ReportOptions {
  std::vector<std::string> folders;
  std::string output;
  bool open = false, quiet = false;
};

// With the desktop's own program for it.
void OpenInBrowser(const std::string& path) {
#ifdef __APPLE__
  constexpr const char* kOpener = "open";
#else
  constexpr const char* kOpener = "xdg-open";
#endif
  const pid_t child = fork();
  if (child == 0) {
    execlp(kOpener, kOpener, path.c_str(), static_cast<char*>(nullptr));
    _exit(127);
  }
  int status = 0;
  if (child > 0 && waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0) return;
  throw FileError(path, 0,
                  std::string("written, but ") + kOpener +
                      " could not open it (package xdg-utils on Debian); open the file in a browser");
}

void Report(const ReportOptions& options) {
  std::string output = options.output;
  if (output.empty()) {
    output = options.folders.front() + (options.folders.size() == 1 ? "/report.html" : "/comparison.html");
  }
  std::vector<NamedPath> inputs;
  for (const std::string& folder : options.folders) {
    for (NamedPath& file : RunFiles("DIR", folder)) inputs.push_back(std::move(file));
  }
  CheckOutputPaths({{"--output", output}}, inputs);
  WriteReport(options.folders, output);
  output = std::filesystem::absolute(output).lexically_normal().string();
  if (!options.quiet && std::filesystem::is_regular_file(output)) {
    std::cout << "report: " << output << '\n';
    FlushOutput();
  }
  if (options.open) OpenInBrowser(output);
}

}  // namespace

void AddReportCommand(CLI::App& app) {
  auto options = std::make_shared<ReportOptions>();
  CLI::App* command = app.add_subcommand("report", "A run as one HTML page: map, decisions, plots; two side by side");
  command->add_option("DIR", options->folders, "The folder of a run (compact, kitti, table); a second to compare with")
      ->required()
      ->expected(1, 2)
      ->option_text("DIR [DIR]");
  command->add_option("--output", options->output, "The page; by default report.html (of two, comparison.html) in DIR")
      ->type_name("FILE");
  command->add_flag("--open", options->open, "Show it in the browser");
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  command->footer(
      "Example: terse generate ellipse --output ellipse.g2o &&\n"
      "         terse compact ellipse.g2o --output ellipse_compact &&\n"
      "         terse compact ellipse.g2o --strategy apal --output ellipse_apal &&\n"
      "         terse report ellipse_apal ellipse_compact");
  command->callback([options] { Report(*options); });
}

}  // namespace terse
