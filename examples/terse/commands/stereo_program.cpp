#include "commands/stereo_program.h"

#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>

namespace terse {
namespace {

// Seen from this program; empty if the system does not tell where that is.
std::filesystem::path StereoProgram() {
  std::error_code error;
  const auto self = std::filesystem::read_symlink("/proc/self/exe", error);
  return error ? std::filesystem::path() : (self.parent_path() / TERSE_STEREO_PROGRAM).lexically_normal();
}

}  // namespace

bool HasStereoProgram() { return access(StereoProgram().c_str(), X_OK) == 0; }

std::string RunStereoProgram(char** argv) {
  const std::string program = StereoProgram().string();
  execv(program.c_str(), argv);
  return "the stereo front end, " + (program.empty() ? "/proc/self/exe" : program) + ": " + std::strerror(errno) +
         "; it is built where OpenCV is found (libopencv-dev, -DTERSE_BUILD_FRONTEND=ON)";
}

}  // namespace terse
