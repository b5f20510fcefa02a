#include "commands/stereo_program.h"

#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <stdexcept>
#include <system_error>

namespace terse {
namespace {

std::filesystem::path StereoProgram() {
  const auto self = std::filesystem::read_symlink("/proc/self/exe");
  return (self.parent_path() / TERSE_STEREO_PROGRAM).lexically_normal();
}

}  // namespace

bool HasStereoProgram() {
  std::error_code ignored;
  return std::filesystem::exists(StereoProgram(), ignored);
}

void RunStereoProgram(char** argv) {
  const std::filesystem::path program = StereoProgram();
  execv(program.c_str(), argv);
  const std::string cause = std::generic_category().message(errno);
  throw std::runtime_error("the stereo front end, " + program.string() + ": " + cause +
                           "; it is built where OpenCV is found (libopencv-dev, -DTERSE_BUILD_FRONTEND=ON)");
}

}  // namespace terse
