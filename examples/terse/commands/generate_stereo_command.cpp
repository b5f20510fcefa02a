// terse generate stereo: a rendered street as a KITTI sequence.

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <memory>
#include <thread>

#include "commands/commands.h"
#include "commands/stereo_program.h"
#include "run/progress.h"
#include "terse/frontend/street_sequence.h"

namespace terse {
namespace {

struct GenerateStereoOptions {
  StreetOptions street;
  std::string output;
  int threads = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  bool quiet = false;
};

// "1226x370".
bool ParseSize(const std::string& text, int& width, int& height) {
  const char* const end = text.data() + text.size();
  const auto [middle, error] = std::from_chars(text.data(), end, width);
  if (error != std::errc() || middle == end || *middle != 'x') return false;
  const auto [last, height_error] = std::from_chars(middle + 1, end, height);
  return height_error == std::errc() && last == end && width >= 16 && height >= 16 && width <= 8192 && height <= 8192;
}

void RunGenerateStereo(const GenerateStereoOptions& options) {
  const StreetSequence sequence(options.street);
  Progress progress("generate", options.street.frames, options.quiet);
  WriteStreet(sequence, options.output, options.threads, [&](int done) { progress.Update(done); });
}

void AddStreetOptions(CLI::App& command, StreetOptions& street) {
  command.add_option("--frames", street.frames, "Frames of all laps together, 10 a second")
      ->check(CLI::Range(1, 1000000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command.add_option("--laps", street.laps, "How often the same street is driven")
      ->check(CLI::Range(1, 10000).description(""))
      ->type_name("N")
      ->capture_default_str();
  command
      .add_option_function<std::string>(
          "--size",
          [&street](const std::string& text) {
            if (!ParseSize(text, street.width, street.height)) {
              throw CLI::ValidationError("--size", text + " is not a size such as 1226x370");
            }
          },
          "Pixels of an image")
      ->type_name("WxH")
      ->default_str("1226x370");
  AddSeedOption(command, street.seed, "Same seed, same street and images");
  command.add_option("--speed", street.metres_per_frame, "Metres per frame")
      ->check(CLI::Range(0.1, 5.0).description(""))
      ->type_name("M")
      ->capture_default_str();
  const auto add = [&](const char* name, double& value, double low, double high, const char* description) {
    command.add_option(name, value, description)
        ->check(CLI::Range(low, high).description(""))
        ->type_name("X")
        ->capture_default_str();
  };
  add("--noise", street.noise, 0, 50, "Standard deviation of the noise, grey levels");
  add("--contrast", street.contrast, 0, 1, "Contrast of the textures");
  add("--disparity-offset", street.disparity_offset, -5, 5, "Disparity of the images minus that of calib.txt, pixels");
  command.add_flag("--twins", street.twins, "The second half of a lap looks like the first, house by house");
  add("--exposure", street.exposure, 0, 0.9, "By how much of itself the gain varies");
}

}  // namespace

void AddGenerateStereo(CLI::App& generate) {
  auto options = std::make_shared<GenerateStereoOptions>();
  CLI::App* command = generate.add_subcommand("stereo", kGenerateStereoDescription);
  AddStreetOptions(*command, options->street);
  command->add_option("--output", options->output, "The folder; its image folders must be empty")
      ->required()
      ->type_name("DIR");
  command->add_option("--threads", options->threads, "The images are the same for any number")
      ->check(CLI::Range(1, 1024).description(""))
      ->type_name("N")
      ->capture_default_str();
  command->add_flag("--quiet", options->quiet, "No progress line");
  command->footer("Example: terse generate stereo --laps 1 --frames 180 --size 306x92 --output street");
  command->callback([options] { RunGenerateStereo(*options); });
}

}  // namespace terse
