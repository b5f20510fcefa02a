// In builds without the stereo front end.

#include <stdexcept>

#include "commands/commands.h"

namespace terse {

void AddKittiCommand(CLI::App& app) {
  CLI::App* command = app.add_subcommand("kitti", "A compact map from a stereo sequence (not in this build)");
  command->allow_extras();
  command->callback([] {
    throw std::invalid_argument("this terse was built without the stereo front end, as OpenCV was not found then");
  });
}

}  // namespace terse
