#include "terse/core/freed_memory.h"

#include <malloc.h>
#include <sys/mman.h>
#include <sys/resource.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>

namespace terse {

#if defined(M_MMAP_THRESHOLD) && defined(MADV_HUGEPAGE)
namespace {

// Address space alone, until it is used. Where that is limited it is left to what needs it.
void TakeHeapInLargePages(std::size_t bytes) {
  constexpr std::size_t kLargePage = std::size_t{1} << 21;
  rlimit limit{};
  if (getrlimit(RLIMIT_AS, &limit) != 0 || limit.rlim_cur / 16 < bytes) return;
  if (mallopt(M_MMAP_MAX, 0) == 0) return;  // the next piece is of the heap; another allocator says no
  if (void* const piece = std::malloc(bytes)) {
    const std::size_t before = kLargePage - reinterpret_cast<std::uintptr_t>(piece) % kLargePage;
    madvise(static_cast<char*>(piece) + before, bytes - before, MADV_HUGEPAGE);
    std::free(piece);
  }
  mallopt(M_MMAP_MAX, 65536);  // glibc's own
}

}  // namespace
#endif

void KeepFreedMemory() {
#ifdef M_MMAP_THRESHOLD
  mallopt(M_MMAP_THRESHOLD, 32 << 20);  // the most that is taken
  mallopt(M_TRIM_THRESHOLD, 256 << 20);
#ifdef MADV_HUGEPAGE
  TakeHeapInLargePages(std::size_t{192} << 20);
#endif
#endif
}

}  // namespace terse
