#pragma once
// Buffers that fronts hand on to one another: no page of a large one is touched only to be zeroed.

#include <cstddef>
#include <map>
#include <utility>
#include <vector>

namespace terse::internal {

// Taken buffers hold anything. A copy of a pool is empty.
class BufferPool {
 public:
  BufferPool() = default;
  BufferPool(const BufferPool&) {}
  BufferPool(BufferPool&&) noexcept = default;
  BufferPool& operator=(const BufferPool&) {
    free_.clear();
    return *this;
  }
  BufferPool& operator=(BufferPool&&) noexcept = default;
  ~BufferPool() = default;

  // At least `size` long, at most an eighth longer.
  std::vector<double> Take(std::size_t size) {
    if (size < kSmall) return std::vector<double>(size);
    size = Rounded(size);
    const auto it = free_.find(size);
    if (it == free_.end() || it->second.empty()) return std::vector<double>(size);
    std::vector<double> out = std::move(it->second.back());
    it->second.pop_back();
    return out;
  }
  // What the pool has no room for is freed.
  void Give(std::vector<double>&& buffer) noexcept {
    if (buffer.size() < kSmall || buffer.size() != Rounded(buffer.size())) return std::vector<double>().swap(buffer);
    const auto it = free_.find(buffer.size());
    if (it != free_.end() && it->second.size() < kKept) {
      it->second.push_back(std::move(buffer));
    } else {
      std::vector<double>().swap(buffer);
    }
  }
  // So that Give never allocates.
  void MakeRoom(std::size_t size) {
    if (size >= kSmall) free_[Rounded(size)].reserve(kKept);
  }

 private:
  static constexpr std::size_t kSmall = 512, kKept = 4;
  static std::size_t Rounded(std::size_t size) {
    std::size_t step = kSmall / 8;
    while (step * 16 <= size) step *= 2;
    return (size + step - 1) / step * step;
  }

  std::map<std::size_t, std::vector<std::vector<double>>> free_;  // by length
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
  std::vector<double> Take(std::size_t size) {
    if (size < kLeast || size > kMost) return std::vector<double>(size);
    const auto it = free_.lower_bound(size);
    if (it == free_.end() || it->first > kFit * size) return std::vector<double>(size + size / 8);
    std::vector<double> out = std::move(it->second);
    free_.erase(it);
    scalars_ -= out.size();
    return out;
  }
  // What there is no room for is freed.
  void Give(std::vector<double>&& buffer) {
    const std::size_t size = buffer.size();
    if (size < kLeast || scalars_ + size > kMost) return std::vector<double>().swap(buffer);
    scalars_ += size;
    free_.emplace(size, std::move(buffer));
  }

 private:
  static constexpr std::size_t kMost = 4000000, kFit = 4;  // scalars in all; times what is wanted
  std::multimap<std::size_t, std::vector<double>> free_;   // by length
  std::size_t scalars_ = 0;
};

}  // namespace terse::internal
