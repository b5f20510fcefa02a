#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <set>
#include <system_error>

#include "commands/commands.h"
#include "commands/output_paths.h"
#include "pictures/compared_runs.h"
#include "pictures/map_picture.h"
#include "pictures/run_charts.h"
#include "pictures/svg_chart.h"
#include "run/standard_output.h"
#include "terse/core/atomic_file.h"
#include "terse/core/writable.h"

namespace terse {
namespace {

enum class PictureFormat { kSvg, kPng, kBoth };

struct PlotOptions {
  std::vector<std::string> folders, what{"trajectory", "gains", "timings"};
  std::string output;
  PictureFormat format = PictureFormat::kSvg;
  int width = 1800;
  bool quiet = false;
};

// A file without a name, which nobody else can open or put a link in the place of.
using NamelessFile = std::unique_ptr<std::FILE, int (*)(std::FILE*)>;
NamelessFile OpenNameless(const std::string& purpose) {
  NamelessFile file(std::tmpfile(), std::fclose);
  if (!file) throw FileError(purpose, 0, "no temporary file: " + std::generic_category().message(errno));
  return file;
}

// Runs rsvg-convert, the program of librsvg, which draws text with the system's fonts. False if there is none.
bool RunRsvgConvert(std::FILE* svg, std::FILE* png, int width, const std::string& path) {
  const std::string pixels = std::to_string(width);
  const char* arguments[] = {"rsvg-convert", "--width", pixels.c_str(), "--keep-aspect-ratio", nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, fileno(svg), STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&actions, fileno(png), STDOUT_FILENO);
  pid_t child = 0;
  const int failed =
      posix_spawnp(&child, arguments[0], &actions, nullptr, const_cast<char* const*>(arguments), environ);
  posix_spawn_file_actions_destroy(&actions);
  if (failed != 0) return false;
  int status = 0;
  pid_t ended = 0;
  while ((ended = waitpid(child, &status, 0)) < 0 && errno == EINTR) continue;
  if (ended == child && WIFEXITED(status) && WEXITSTATUS(status) == 127) return false;
  if (ended != child || !WIFEXITED(status) || WEXITSTATUS(status) != 0) {
    throw FileError(path, 0, "rsvg-convert could not draw it");
  }
  return true;
}

void WritePng(const std::string& svg, const std::string& path, int width) {
  AtomicFile file(path);
  const NamelessFile in = OpenNameless(path), out = OpenNameless(path);
  if (std::fwrite(svg.data(), 1, svg.size(), in.get()) != svg.size() || std::fflush(in.get()) != 0) {
    throw FileError(path, 0, "no temporary file: " + std::generic_category().message(errno));
  }
  std::rewind(in.get());
  if (!RunRsvgConvert(in.get(), out.get(), width, path)) {
    throw FileError(path, 0, "needs the program rsvg-convert (package librsvg2-bin on Debian); --format svg does not");
  }
  std::rewind(out.get());
  std::array<char, 65536> block;
  for (std::size_t count = 0; (count = std::fread(block.data(), 1, block.size(), out.get())) > 0;) {
    file.Stream().write(block.data(), static_cast<std::streamsize>(count));
  }
  if (std::ferror(out.get()) != 0) throw FileError(path, 0, "cannot read what rsvg-convert drew");
  file.Commit();
}

// A picture's name may be a link to a file of the run.
void CheckPictures(const PlotOptions& options, const std::string& folder) {
  std::vector<NamedPath> inputs, outputs;
  for (const std::string& run : options.folders) {
    for (NamedPath& file : RunFiles("DIR", run)) inputs.push_back(std::move(file));
  }
  for (const std::string& what : std::set<std::string>(options.what.begin(), options.what.end())) {
    const std::string stem = folder + (options.folders.size() > 1 ? "/comparison_" : "/") + what;
    if (options.format != PictureFormat::kPng) outputs.push_back({"--output", stem + ".svg"});
    if (options.format != PictureFormat::kSvg) outputs.push_back({"--output", stem + ".png"});
  }
  CheckOutputPaths(outputs, inputs);
}

void Plot(const PlotOptions& options) {
  const std::string folder = options.output.empty() ? options.folders.front() : options.output;
  CheckPictures(options, folder);
  const std::vector<RunFolder> runs = ReadRunFolders(options.folders);
  RequireFolder(folder, options.what.front() + ".svg");
  for (const std::string& what : options.what) {
    const std::string stem = folder + (runs.size() > 1 ? "/comparison_" : "/") + what, svg = stem + ".svg";
    const bool keep = options.format != PictureFormat::kPng;
    const std::string drawn = what == "trajectory" ? DrawMaps(runs)
                              : what == "gains"    ? DrawGains(runs)
                                                   : DrawTimings(runs);
    if (keep) WriteText(drawn, svg);
    if (options.format != PictureFormat::kSvg) WritePng(drawn, stem + ".png", options.width);
    if (options.quiet) continue;
    if (keep) std::cout << svg << '\n';
    if (options.format != PictureFormat::kSvg) std::cout << stem << ".png\n";
  }
  FlushOutput();
}

}  // namespace

void AddPlotCommand(CLI::App& app) {
  auto options = std::make_shared<PlotOptions>();
  CLI::App* command = app.add_subcommand("plot", "Pictures of a run, or of two, for papers: map, gains, timings");
  command->add_option("DIR", options->folders, "The folder of a run (compact, kitti, table); a second to compare with")
      ->required()
      ->expected(1, 2)
      ->option_text("DIR [DIR]");
  command->add_option("--what", options->what, "Which pictures; by default all three")
      ->delimiter(',')
      ->check(CLI::IsMember({"trajectory", "gains", "timings"}).description(""))
      ->type_name("trajectory,gains,timings")
      ->default_str("");
  command->add_option("--output", options->output, "Folder for the pictures; by default the first DIR")
      ->type_name("DIR");
  AddChoice(*command, "--format", options->format,
            {{"svg", PictureFormat::kSvg}, {"png", PictureFormat::kPng}, {"both", PictureFormat::kBoth}},
            "PNG needs rsvg-convert (librsvg2-bin)");
  command->add_option("--width", options->width, "Of a PNG in pixels")
      ->check(CLI::Range(100, 20000).description(""))
      ->type_name("PIXELS")
      ->capture_default_str();
  command->add_flag("--quiet", options->quiet, "Print nothing but errors");
  command->footer(
      "Example: terse generate ellipse --output ellipse.g2o &&\n"
      "         terse compact ellipse.g2o --output ellipse_compact &&\n"
      "         terse plot ellipse_compact --what trajectory,gains");
  command->callback([options] { Plot(*options); });
}

}  // namespace terse
