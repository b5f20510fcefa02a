#pragma once
// Lines of a text file one at a time, for files that need not fit into memory.

#include <fstream>
#include <string>

#include "terse/core/text_lines.h"

namespace terse {

class LineStream {
 public:
  // Throws FileError if the file is missing, a folder or unreadable.
  explicit LineStream(const std::string& path);
  // The next line that is neither blank nor a comment; false at the end. The view lives until the next call. Throws
  // FileError for a line beyond kMostLineBytes, a zero byte, or if reading fails.
  bool Next(TextLine& line);
  const std::string& Path() const { return path_; }

 private:
  bool ReadRaw();

  std::string path_, raw_;
  std::ifstream file_;
  long number_ = 0;
};

struct FileFingerprint {
  std::uint64_t bytes = 0;
  std::uint32_t crc32 = 0;
};
// Of a whole file, read in pieces. Throws FileError as LineStream does.
FileFingerprint FingerprintOf(const std::string& path);

}  // namespace terse
