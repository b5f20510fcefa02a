#pragma once
// Reading and writing through open descriptors, whatever interrupts or shortens the calls.

#include <array>
#include <cstddef>
#include <streambuf>
#include <string>
#include <string_view>

namespace terse {

// Writes all of it: 0, or the errno of the call that failed.
int WriteAll(int descriptor, std::string_view bytes);

// Up to `size` bytes; how many, 0 at the end, -1 with errno set on failure.
long ReadSome(int descriptor, char* bytes, std::size_t size);

// Brings what was written to the disk, where the file system can: 0 or an errno.
int SyncData(int descriptor);

// Brings the name of a new file to the disk. Some file systems cannot: it lasts all the same unless the power fails.
void SyncFolderOf(const std::string& path);

// What is wrong, in the system's words.
std::string SystemReason(int error);

// Buffered output to a descriptor that stays the caller's. The first failure lasts: Error() names it, and nothing is
// written after it.
class DescriptorBuffer : public std::streambuf {
 public:
  explicit DescriptorBuffer(int descriptor);
  int Error() const { return error_; }

 protected:
  int_type overflow(int_type c) override;
  int sync() override;

 private:
  int descriptor_, error_ = 0;
  std::array<char, 1 << 16> bytes_;
};

}  // namespace terse
