// Stands in for `terse generate stereo` where the stereo front end is not built.

#include <stdexcept>

#include "commands/commands.h"

namespace terse {

void AddGenerateStereo(CLI::App& generate) {
  CLI::App* command =
      generate.add_subcommand("stereo", "Not in this build: rendering needs the stereo front end, and that OpenCV");
  command->allow_extras();
  command->callback([] {
    throw std::invalid_argument(
        "generate stereo is not in this build; install OpenCV and configure with -DTERSE_BUILD_FRONTEND=ON");
  });
}

}  // namespace terse
