#pragma once
// The one way in which files come into memory.

#include <cstdint>
#include <functional>
#include <string>
#include <string_view>
#include <utility>

#include "terse/core/error.h"
#include "terse/core/file_version.h"
#include "terse/core/limits.h"

namespace terse {

// A file open for reading. Throws FileError if it is missing, a folder, or cannot be read.
class InputFile {
 public:
  explicit InputFile(const std::string& path);
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;
  const std::string& Path() const { return path_; }
  // On a disk: it has a size and can be read again. A pipe or a device has neither.
  bool IsStored() const { return is_stored_; }
  // When it was opened; of stored files only.
  const FileVersion& Version() const { return version_; }
  // Up to `size` bytes; how many, 0 at the end.
  std::size_t Read(char* bytes, std::size_t size);
  // Throws FileError if a stored file is not what it was when it was opened, or then.
  void ExpectUnchanged() const { ExpectUnchanged(version_); }
  void ExpectUnchanged(const FileVersion& since) const;
  // Reads from the start again; stored files only.
  void Rewind();

 private:
  InputFile(std::string path, int descriptor) : path_(std::move(path)), descriptor_(descriptor) {}

  std::string path_;
  int descriptor_;
  bool is_stored_ = false;
  FileVersion version_;
};

struct ReadLimits {
  std::uint64_t most_bytes = MostFileBytes(kMostFileBytes, 4);
  // Sees what the file begins with, some 64 KiB or all of it, and throws if that is no such file: what has no end
  // (/dev/zero) is refused there.
  std::function<void(std::string_view start)> check_start;
};

// The bytes of a file. Memory grows with what is there, not with what the file claims. Throws FileError if it is
// missing, a folder, unreadable or larger than the limit.
std::string ReadAll(const std::string& path, const ReadLimits& limits = {});

// The content of a file of text. Throws FileError as ReadAll does, and for a binary one (it holds NUL bytes) soon, even
// if it has no end.
std::string ReadText(const std::string& path, std::uint64_t most_bytes = ReadLimits().most_bytes);

// The error of a file that holds more bytes than that.
FileError TooLarge(const std::string& path, std::uint64_t most_bytes);
// Throws FileError if what begins with line `first_line` holds a zero byte.
void ExpectText(const std::string& path, std::string_view content, long first_line = 1);

}  // namespace terse
