#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <filesystem>
#include <iostream>

#include "commands.h"
#include "map_picture.h"
#include "run_charts.h"
#include "svg_chart.h"

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

// By the program of librsvg, which draws text with the system's fonts.
void WritePng(const std::string& svg, const std::string& png, int width) {
  const std::string pixels = std::to_string(width), temporary = png + ".new";
  const char* arguments[] = {"rsvg-convert", "--width",         pixels.c_str(), "--keep-aspect-ratio",
                             "--output",     temporary.c_str(), svg.c_str(),    nullptr};
  pid_t child = 0;
  const int failed = posix_spawnp(&child, arguments[0], nullptr, nullptr, const_cast<char* const*>(arguments), environ);
  int status = 0;
  const bool done = failed == 0 && waitpid(child, &status, 0) == child && WIFEXITED(status);
  if (done && WEXITSTATUS(status) == 0) {
    std::filesystem::rename(temporary, png);
    return;
  }
  std::error_code ignored;
  std::filesystem::remove(temporary, ignored);
  throw FileError(png, 0,
                  failed != 0 || (done && WEXITSTATUS(status) == 127)
                      ? "needs the program rsvg-convert (package librsvg2-bin on Debian); --format svg does not"
                      : "rsvg-convert could not write it");
}

void Plot(const PlotOptions& options) {
  const std::vector<RunFolder> runs = ReadRunFolders(options.folders);
  const std::string folder = options.output.empty() ? options.folders.front() : options.output;
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (!std::filesystem::is_directory(folder)) throw FileError(folder, 0, "cannot make this folder: " + error.message());
  for (const std::string& what : options.what) {
    const std::string stem = folder + (runs.size() > 1 ? "/comparison_" : "/") + what, svg = stem + ".svg";
    // A picture that is asked for as PNG alone leaves no other.
    const bool keep = options.format != PictureFormat::kPng;
    const std::string drawn = keep ? svg : stem + ".tmp.svg";
    WriteText(what == "trajectory" ? DrawMaps(runs) : what == "gains" ? DrawGains(runs) : DrawTimings(runs), drawn);
    if (options.format != PictureFormat::kSvg) {
      try {
        WritePng(drawn, stem + ".png", options.width);
      } catch (...) {
        if (!keep) std::filesystem::remove(drawn);
        throw;
      }
      if (!keep) std::filesystem::remove(drawn);
    }
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
      "         terse compact ellipse.g2o --output ellipse_fpfl &&\n"
      "         terse plot ellipse_fpfl --what trajectory,gains");
  command->callback([options] { Plot(*options); });
}

}  // namespace terse
