#include "terse/core/front_buffer.h"

#include <sys/mman.h>

#include <cstdlib>

namespace terse::internal {

void* AllocateBuffer(std::size_t bytes) {
  constexpr std::size_t kLargePage = std::size_t{1} << 21, kLarge = 2 * kLargePage;
  void* buffer = nullptr;
  if (bytes < kLarge) {
    buffer = std::malloc(bytes);
  } else if (::posix_memalign(&buffer, kLargePage, bytes) != 0) {
    buffer = nullptr;
  }
  if (buffer == nullptr) throw std::bad_alloc();
#ifdef MADV_HUGEPAGE
  // Refused where the system has no large pages. What shares the last one with the buffer has it too.
  if (bytes >= kLarge) ::madvise(buffer, (bytes + kLargePage - 1) / kLargePage * kLargePage, MADV_HUGEPAGE);
#endif
  return buffer;
}

void FreeBuffer(void* buffer) noexcept { std::free(buffer); }

}  // namespace terse::internal
