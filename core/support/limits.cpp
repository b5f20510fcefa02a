#include "terse/core/limits.h"

#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <sstream>
#include <string>

namespace terse {
namespace {

// "max" where there is no limit.
std::uint64_t NumberIn(const char* path) {
  std::ifstream file(path);
  std::uint64_t number = 0;
  return file >> number ? number : UINT64_MAX;
}

// Of the line that begins with this word, in so many bytes; "max" where there is none.
std::uint64_t NumberAfter(const std::string& word, const char* path, std::uint64_t unit) {
  std::ifstream file(path);
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    std::string first;
    std::uint64_t number = 0;
    if (words >> first >> number && first == word) return number * unit;
  }
  return UINT64_MAX;
}

// "max" where it has no limit.
std::uint64_t AddressSpace() {
  rlimit limit{};
  const bool is_limited = ::getrlimit(RLIMIT_AS, &limit) == 0 && limit.rlim_cur != RLIM_INFINITY;
  return is_limited ? static_cast<std::uint64_t>(limit.rlim_cur) : UINT64_MAX;
}

// What is left of a limit, of which so much is in use, as far as both are known.
std::uint64_t Rest(std::uint64_t limit, std::uint64_t used) {
  return limit == UINT64_MAX || used == UINT64_MAX ? limit : limit - std::min(limit, used);
}

std::uint64_t FindUsableMemory() {
  std::uint64_t least = UINT64_MAX;
  const long pages = ::sysconf(_SC_PHYS_PAGES), page = ::sysconf(_SC_PAGESIZE);
  if (pages > 0 && page > 0) least = static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page);
  least = std::min(least, NumberIn("/sys/fs/cgroup/memory.max"));
  least = std::min(least, NumberIn("/sys/fs/cgroup/memory/memory.limit_in_bytes"));
  return std::min(least, AddressSpace());
}

}  // namespace

std::uint64_t UsableMemory() {
  static const std::uint64_t bytes = FindUsableMemory();
  return bytes;
}

std::uint64_t FreeMemory() {
  std::uint64_t least = std::min(UsableMemory(), NumberAfter("MemAvailable:", "/proc/meminfo", 1024));
  least = std::min(least, Rest(AddressSpace(), NumberAfter("VmSize:", "/proc/self/status", 1024)));
  const auto of_group = [&](const std::string& folder, const char* limit, const char* usage, const char* files) {
    const std::uint64_t used = NumberIn((folder + usage).c_str());
    const std::uint64_t copies = NumberAfter(files, (folder + "memory.stat").c_str(), 1);
    least = std::min(least, Rest(NumberIn((folder + limit).c_str()), copies == UINT64_MAX ? used : Rest(used, copies)));
  };
  of_group("/sys/fs/cgroup/", "memory.max", "memory.current", "inactive_file");
  of_group("/sys/fs/cgroup/memory/", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file");
  return least;
}

std::uint64_t MostGraphBytes() {
  const std::uint64_t usable = UsableMemory();
  return usable > UINT64_MAX / 2 ? UINT64_MAX : 2 * usable;
}

std::uint64_t MostFileBytes(std::uint64_t limit, std::uint64_t share_of_memory) {
  constexpr std::uint64_t kMebibyte = std::uint64_t{1} << 20;
  return std::min(limit, std::max(UsableMemory() / share_of_memory / kMebibyte, std::uint64_t{1}) * kMebibyte);
}

}  // namespace terse
