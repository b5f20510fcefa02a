#pragma once
#include <atomic>
#include <cstdint>

namespace terse::internal {

// Never the same number twice, so that a cache notices another object in the place of its own.
inline std::uint64_t NextVersion() {
  static std::atomic<std::uint64_t> last{0};
  return ++last;
}

}  // namespace terse::internal
