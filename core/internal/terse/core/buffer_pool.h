#pragma once
// Buffers that fronts hand on to one another: no page of a large one is touched only to be zeroed.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "terse/core/front_buffer.h"

namespace terse::internal {

// Taken buffers hold anything. A copy of a pool is empty. It holds a few times its largest buffer at most: what was
// given longest ago goes.
class BufferPool {
 public:
  BufferPool() = default;
  BufferPool(const BufferPool&) noexcept {}
  BufferPool(BufferPool&& other) noexcept { Exchange(other); }  // left empty
  BufferPool& operator=(const BufferPool&) noexcept {
    BufferPool empty;
    Exchange(empty);
    return *this;
  }
  BufferPool& operator=(BufferPool&& other) noexcept {
    Exchange(other);
    return *this;
  }
  ~BufferPool() = default;

  // At least `size` long, at most three eighths longer.
  FrontBuffer Take(std::size_t size) {
    if (size < kSmall) return FrontBuffer(size);
    size = Rounded(size);
    for (auto it = free_.lower_bound(size); it != free_.end() && it->first <= size + size / 4; ++it) {
      if (it->second.empty()) continue;
      FrontBuffer out = std::move(it->second.back().buffer);
      it->second.pop_back();
      scalars_ -= out.size();
      return out;
    }
    return FrontBuffer(size);
  }
  // What the pool has no room for is freed.
  void Give(FrontBuffer&& buffer) noexcept {
    const std::size_t size = buffer.size();
    if (size < kSmall || size != Rounded(size)) return FrontBuffer().swap(buffer);
    const auto it = free_.find(size);
    if (it == free_.end() || it->second.size() == kKept) return FrontBuffer().swap(buffer);
    it->second.push_back({std::move(buffer), ++given_});
    scalars_ += size;
    if (size > largest_) largest_ = size;
    while (scalars_ > std::max(kAlways, kTimesLargest * largest_)) FreeOldest();
  }
  // So that Give never allocates.
  void MakeRoom(std::size_t size) {
    if (size >= kSmall) free_[Rounded(size)].reserve(kKept);
  }
  // That it holds.
  std::size_t Scalars() const { return scalars_; }

 private:
  static constexpr std::size_t kSmall = 512, kKept = 4;               // scalars; of a size
  static constexpr std::size_t kAlways = 1 << 20, kTimesLargest = 4;  // scalars in all
  struct Kept {
    FrontBuffer buffer;
    std::uint64_t given;
  };

  static std::size_t Rounded(std::size_t size) {
    std::size_t step = kSmall / 8;
    while (step * 16 <= size) step *= 2;
    return (size + step - 1) / step * step;
  }
  void FreeOldest() noexcept {
    std::vector<Kept>* oldest = nullptr;
    for (auto& [size, kept] : free_) {
      if (!kept.empty() && (oldest == nullptr || kept.front().given < oldest->front().given)) oldest = &kept;
    }
    scalars_ -= oldest->front().buffer.size();
    oldest->erase(oldest->begin());
  }
  void Exchange(BufferPool& other) noexcept {
    free_.swap(other.free_);
    std::swap(scalars_, other.scalars_);
    std::swap(largest_, other.largest_);
    std::swap(given_, other.given_);
  }

  std::map<std::size_t, std::vector<Kept>> free_;  // by length; those given first in front
  std::size_t scalars_ = 0, largest_ = 0;
  std::uint64_t given_ = 0;
};

// For buffers that live shortly, of sizes that never come again: the smallest that is long enough is taken, so that few
// are in use, which stay in the caches. A copy of a pool is empty, and so is one that it was moved to.
class ShortLivedBuffers {
 public:
  static constexpr std::size_t kLeast = 128;  // scalars: smaller ones are not worth it
  ShortLivedBuffers() = default;
  ShortLivedBuffers(const ShortLivedBuffers&) noexcept {}
  ShortLivedBuffers& operator=(const ShortLivedBuffers&) noexcept { return *this; }
  ~ShortLivedBuffers() = default;

  // At least `size` long; holds anything.
  FrontBuffer Take(std::size_t size) {
    if (size < kLeast || size > kMost) return FrontBuffer(size);
    const auto it = free_.lower_bound(size);
    if (it == free_.end() || it->first > kFit * size) return FrontBuffer(size + size / 8);
    FrontBuffer out = std::move(it->second);
    free_.erase(it);
    scalars_ -= out.size();
    return out;
  }
  // What there is no room for is freed.
  void Give(FrontBuffer&& buffer) {
    const std::size_t size = buffer.size();
    if (size < kLeast || scalars_ + size > kMost) return FrontBuffer().swap(buffer);
    scalars_ += size;
    free_.emplace(size, std::move(buffer));
  }

 private:
  static constexpr std::size_t kMost = 4000000, kFit = 4;  // scalars in all; times what is wanted
  std::multimap<std::size_t, FrontBuffer> free_;           // by length
  std::size_t scalars_ = 0;
};

}  // namespace terse::internal
