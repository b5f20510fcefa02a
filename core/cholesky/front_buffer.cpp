#include "terse/core/front_buffer.h"

#include <sys/mman.h>

#include <cstdlib>

namespace terse::internal {

void* AllocateBuffer(std::size_t bytes) {
  constexpr std::size_t kLargePage = std::size_t{1} << 21, kLeast = 2 * kLargePage;
  const bool is_large = bytes >= kLeast;
  const std::size_t size = is_large ? (bytes + kLargePage - 1) / kLargePage * kLargePage : bytes;
  void* const buffer = is_large ? std::aligned_alloc(kLargePage, size) : std::malloc(size);
  if (buffer == nullptr) throw std::bad_alloc();
#ifdef MADV_HUGEPAGE
  if (is_large) ::madvise(buffer, size, MADV_HUGEPAGE);  // no promise, only faster
#endif
  return buffer;
}

void FreeBuffer(void* buffer) noexcept { std::free(buffer); }

}  // namespace terse::internal
