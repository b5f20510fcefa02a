#pragma once
// Sanitizers slow everything down ten to fifty times: in their builds, runs over whole data sets leave a part out, and
// randomised tests draw less often.

#include <cstdint>
#include <vector>

namespace terse {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kSlowBuild = true;
#elif defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
constexpr bool kSlowBuild = true;
#else
constexpr bool kSlowBuild = false;
#endif
#else
constexpr bool kSlowBuild = false;
#endif

namespace testing {

// first, ..., last; in a slow build the first third of them.
inline std::vector<std::uint64_t> Seeds(std::uint64_t first, std::uint64_t last) {
  std::vector<std::uint64_t> seeds;
  const std::uint64_t count = last - first + 1;
  for (std::uint64_t k = 0; k < (kSlowBuild ? (count + 2) / 3 : count); ++k) seeds.push_back(first + k);
  return seeds;
}

}  // namespace testing
}  // namespace terse
