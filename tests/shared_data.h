#pragma once
// Public data sets, which are not part of the repository: looked for in ../shared/data next to it.

#include <filesystem>
#include <optional>
#include <string>

namespace terse {

// The path of a file or folder there, if present. Tests that need it call GTEST_SKIP() when it is not.
inline std::optional<std::string> SharedData(const std::string& relative) {
  const std::filesystem::path path = std::filesystem::path(TERSE_SOURCE_DIR) / ".." / "shared" / "data" / relative;
  if (!std::filesystem::exists(path)) return std::nullopt;
  return path.string();
}

}  // namespace terse
