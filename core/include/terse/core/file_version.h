#pragma once

#include <cstdint>

namespace terse {

// Size and last change of a file on a disk: it is not the same file any more if these are not.
struct FileVersion {
  std::uint64_t bytes = 0;
  std::int64_t changed_ns = 0;  // since 1970
};
inline bool operator==(const FileVersion& a, const FileVersion& b) {
  return a.bytes == b.bytes && a.changed_ns == b.changed_ns;
}

}  // namespace terse
