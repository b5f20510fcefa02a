#pragma once
// Public data sets, which are not part of the repository: looked for in ../shared/data next to it.

#include <filesystem>
#include <optional>
#include <string>

#include "slow_build.h"

namespace terse {

// The path of a file or folder there, if present.
inline std::optional<std::string> SharedData(const std::string& relative) {
  const std::filesystem::path path = std::filesystem::path(TERSE_SOURCE_DIR) / ".." / "shared" / "data" / relative;
  if (!std::filesystem::exists(path)) return std::nullopt;
  return path.string();
}

}  // namespace terse

// Declares `variable`, the path of a file or folder there; skips the test if it is absent.
#define TERSE_NEEDS(variable, relative)                                                           \
  if (!::terse::SharedData(relative))                                                             \
    GTEST_SKIP() << "needs the public data ../shared/data/" << (relative) << ", which is absent"; \
  const std::string variable = *::terse::SharedData(relative)
