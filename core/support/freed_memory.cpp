#include "terse/core/freed_memory.h"

#include <malloc.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>

namespace terse {

#if defined(M_MMAP_THRESHOLD) && defined(MADV_HUGEPAGE)
namespace {

// Address space alone, until it is used. Where that is limited it is left to what needs it.
void TakeHeapInLargePages(std::uintptr_t bytes) {
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur / 16 < bytes) return;
  constexpr std::uintptr_t kLargePage = std::uintptr_t{1} << 21;
  mallopt(M_TOP_PAD, static_cast<int>(bytes));
  void* const piece = std::malloc(std::size_t{1} << 20);  // more than there is, so that the heap grows
  const auto begin = reinterpret_cast<std::uintptr_t>(piece), end = reinterpret_cast<std::uintptr_t>(sbrk(0));
  if (piece != nullptr && begin < end && end - begin >= bytes && end - begin < 2 * bytes) {
    const std::uintptr_t before = (kLargePage - begin % kLargePage) % kLargePage;
    madvise(static_cast<char*>(piece) + before, end - begin - before, MADV_HUGEPAGE);
  }
  std::free(piece);
  mallopt(M_TOP_PAD, 1 << 20);
}

}  // namespace
#endif

void KeepFreedMemory() {
#ifdef M_MMAP_THRESHOLD
  mallopt(M_MMAP_THRESHOLD, 32 << 20);  // the most that is taken
  mallopt(M_TRIM_THRESHOLD, 256 << 20);
#ifdef MADV_HUGEPAGE
  TakeHeapInLargePages(std::uintptr_t{192} << 20);
#endif
#endif
}

}  // namespace terse
