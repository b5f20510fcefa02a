#pragma once
// The one way in which files come into memory.

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>

#include "terse/core/limits.h"

namespace terse {

struct ReadLimits {
  std::uint64_t most_bytes = MostFileBytes(kMostFileBytes, 4);
  // Sees what the file begins with, some 64 KiB or all of it, and throws if that is no such file: what has no end
  // (/dev/zero) is refused there.
  std::function<void(std::string_view start)> check_start;
};

// The bytes of a file. Memory grows with what is there, not with what the file claims. Throws FileError if it is
// missing, a folder, unreadable or larger than the limit.
std::string ReadAll(const std::string& path, const ReadLimits& limits = {});

// The content of a file of text. Throws FileError as ReadAll does, and for a binary one (it holds NUL bytes) soon, even
// if it has no end.
std::string ReadText(const std::string& path, std::uint64_t most_bytes = ReadLimits().most_bytes);

}  // namespace terse
