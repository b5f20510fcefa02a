#pragma once
// Memory for the numbers of fronts.

#include <cstddef>
#include <new>
#include <utility>
#include <vector>

namespace terse::internal {

// Large ones are in the system's large pages where it has any: to get memory page by page took a third of a large batch
// solve. Throws std::bad_alloc.
void* AllocateBuffer(std::size_t bytes);
void FreeBuffer(void* buffer) noexcept;

// Elements that are given no value hold anything.
template <class T>
struct BufferAllocator {
  using value_type = T;
  BufferAllocator() = default;
  template <class U>
  BufferAllocator(const BufferAllocator<U>&) noexcept {}
  T* allocate(std::size_t size) { return static_cast<T*>(AllocateBuffer(size * sizeof(T))); }
  void deallocate(T* buffer, std::size_t) noexcept { FreeBuffer(buffer); }
  template <class U>
  void construct(U* at) noexcept {
    ::new (static_cast<void*>(at)) U;
  }
  template <class U, class... Args>
  void construct(U* at, Args&&... args) {
    ::new (static_cast<void*>(at)) U(std::forward<Args>(args)...);
  }
  friend bool operator==(const BufferAllocator&, const BufferAllocator&) { return true; }
  friend bool operator!=(const BufferAllocator&, const BufferAllocator&) { return false; }
};

// Not set to zero: what is read was written before.
using FrontBuffer = std::vector<double, BufferAllocator<double>>;

}  // namespace terse::internal
