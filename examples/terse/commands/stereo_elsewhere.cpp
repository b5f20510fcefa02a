// The subcommands that need the front end, in programs without it. A program that has them never links this file.

#include "commands/commands.h"
#include "commands/stereo_program.h"

namespace terse {
namespace {

void AddStandIn(CLI::App& app, const char* name, const char* description) {
  CLI::App* command = app.add_subcommand(name, description);
  if (HasStereoProgram()) command->set_help_flag();  // its help is the whole one
  command->prefix_command();
  command->callback([] { throw StereoProgramAsked(); });
}

}  // namespace

void AddKittiCommand(CLI::App& app) { AddStandIn(app, "kitti", kKittiDescription); }

void AddGenerateStereo(CLI::App& generate) { AddStandIn(generate, "stereo", kGenerateStereoDescription); }

}  // namespace terse
