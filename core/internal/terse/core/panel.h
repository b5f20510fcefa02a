#pragma once
// Where the numbers of a front of L are: in memory, or in a file if those of all fronts would take too much of it.

#include <cassert>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "terse/core/front_buffer.h"
#include "terse/core/limits.h"

namespace terse::internal {

// A file without a name, as long as somebody holds it, in $TMPDIR or else /var/tmp; read where it is mapped.
class PanelFile {
 public:
  // With room for so many numbers, at least one. Throws FileError if the folder has none, or is in memory itself.
  explicit PanelFile(std::size_t size);
  ~PanelFile();
  PanelFile(const PanelFile&) = delete;
  PanelFile& operator=(const PanelFile&) = delete;

  // Threads may write to different places at once. Throws FileError.
  void Write(std::size_t at, const double* numbers, std::size_t count);
  const double* Numbers(std::size_t at) const { return numbers_ + at; }
  // What was read takes memory until then, or until others need it.
  void Release(std::size_t at, std::size_t count) const noexcept;

 private:
  int descriptor_ = -1;
  std::size_t bytes_ = 0;
  const double* numbers_ = nullptr;
};

// A file for panels of so many numbers if they take more than most_bytes, else none. By default (0) if they take more
// than 64 MiB and than half of the free memory; and none where the disk has no room for it but the memory. Throws
// FileError.
std::shared_ptr<PanelFile> OpenPanelFile(std::size_t numbers, std::uint64_t most_bytes,
                                         std::uint64_t (*free_memory)() = FreeMemory);

// A copy is in memory.
class Panel {
 public:
  Panel() = default;
  Panel(const Panel& other) : buffer_(other.Numbers(), other.Numbers() + other.Size()) {}
  Panel(Panel&& other) noexcept { Swap(other); }
  Panel& operator=(Panel other) noexcept {
    Swap(other);
    return *this;
  }
  ~Panel() = default;
  void Swap(Panel& other) noexcept {
    buffer_.swap(other.buffer_);
    file_.swap(other.file_);
    std::swap(at_, other.at_);
    std::swap(size_, other.size_);
  }

  std::size_t Size() const { return file_ ? size_ : buffer_.size(); }
  const double* Numbers() const { return buffer_.empty() && file_ ? file_->Numbers(at_) : buffer_.data(); }
  // For writing: of a panel in memory, or until it is stored.
  double* Buffer() {
    assert(!file_ || !buffer_.empty());
    return buffer_.data();
  }

  // In memory, whatever it was before.
  void SetBuffer(FrontBuffer&& buffer) {
    *this = Panel();
    buffer_ = std::move(buffer);
  }
  // Left without any; what it gives is empty if the numbers are in a file.
  FrontBuffer TakeBuffer() {
    Panel taken;
    Swap(taken);
    return std::move(taken.buffer_);
  }

  // Has its place in a file from now on: numbers are written to a buffer, then stored.
  void SetPlace(std::shared_ptr<PanelFile> file, std::size_t at, std::size_t size) {
    *this = Panel();
    file_ = std::move(file);
    at_ = at;
    size_ = size;
  }
  bool HasPlace() const { return file_ != nullptr; }
  void BeginStoring(FrontBuffer&& buffer) { buffer_ = std::move(buffer); }
  // Gives the buffer back.
  FrontBuffer Store() {
    file_->Write(at_, buffer_.data(), size_);
    return std::exchange(buffer_, {});
  }
  void Release() const noexcept {
    if (file_) file_->Release(at_, size_);
  }

 private:
  FrontBuffer buffer_;  // at least as long as it has to be; in a file empty but while it is made
  std::shared_ptr<PanelFile> file_;
  std::size_t at_ = 0, size_ = 0;  // in the file
};

}  // namespace terse::internal
