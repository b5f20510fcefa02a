#include "terse/core/writable.h"

#include <filesystem>

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"

namespace terse {

namespace fs = std::filesystem;

void RequireWritable(const std::string& path) {
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  // Merely opening a pipe would already be seen at its other end.
  if (path.empty() || (fs::exists(status) && !fs::is_regular_file(status) && !fs::is_directory(status))) return;
  AtomicFile file(path);  // removed again
}

void RequireFolder(const std::string& path, const std::string& file) {
  std::error_code error;
  fs::create_directories(path, error);
  if (!fs::is_directory(path)) {
    const std::string reason = fs::exists(path) ? "a file of this name is in the way" : error.message();
    throw FileError(path, 0, "cannot make this folder: " + reason);
  }
  RequireWritable(path + '/' + file);
}

}  // namespace terse
