#pragma once
// Memory for the numbers of fronts.

#include <cstddef>
#include <limits>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

namespace terse::internal {

// Large ones are in the system's large pages where it has any: to be given memory page by page took a third of a large
// batch solve. Throws std::bad_alloc.
void* AllocateBuffer(std::size_t bytes);
void FreeBuffer(void* buffer) noexcept;

// Elements that are given no value hold anything; with TERSE_POISON_BUFFERS, as under sanitizers, not a number.
// NOLINTBEGIN(readability-identifier-naming): the names of the standard's allocators
template <class T>
struct BufferAllocator {
  static_assert(std::is_floating_point_v<T> && alignof(T) <= alignof(std::max_align_t));
  using value_type = T;
  BufferAllocator() = default;
  template <class U>
  BufferAllocator(const BufferAllocator<U>&) noexcept {}
  T* allocate(std::size_t size) {
    if (size > std::numeric_limits<std::size_t>::max() / 2 / sizeof(T)) throw std::bad_array_new_length();
    return static_cast<T*>(AllocateBuffer(size * sizeof(T)));
  }
  void deallocate(T* buffer, std::size_t) noexcept { FreeBuffer(buffer); }
  template <class U>
  void construct(U* at) noexcept {
#ifdef TERSE_POISON_BUFFERS
    ::new (static_cast<void*>(at)) U(std::numeric_limits<U>::quiet_NaN());
#else
    ::new (static_cast<void*>(at)) U;
#endif
  }
  template <class U, class... Args>
  void construct(U* at, Args&&... args) {
    ::new (static_cast<void*>(at)) U(std::forward<Args>(args)...);
  }
  friend bool operator==(const BufferAllocator&, const BufferAllocator&) { return true; }
  friend bool operator!=(const BufferAllocator&, const BufferAllocator&) { return false; }
};
// NOLINTEND(readability-identifier-naming)

// Not set to zero: no result depends on what was not written. (Kernels load it beside what they need, and drop it.)
using FrontBuffer = std::vector<double, BufferAllocator<double>>;

}  // namespace terse::internal
