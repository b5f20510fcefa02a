#pragma once
// Lines of a text file one at a time, for files that need not fit into memory.

#include <string>

#include "terse/core/read_file.h"
#include "terse/core/text_lines.h"

namespace terse {

class LineStream {
 public:
  // Throws FileError if the file is missing, a folder or unreadable.
  explicit LineStream(const std::string& path) : file_(path) {}
  // The next line that is neither blank nor a comment; false at the end. The view lives until the next call. Throws
  // FileError for a line beyond kMostLineBytes, a zero byte, if reading fails, and at the end if the file has changed
  // since it was opened. Of a pipe all text is kept, for Rewind: it throws where that is more than a file read whole
  // may have.
  bool Next(TextLine& line);
  // To the first line.
  void Rewind();
  // Of the line that was read last, blank ones and comments counted; 0 at the start and in an empty file.
  long LineNumber() const { return number_; }
  const InputFile& File() const { return file_; }

 private:
  bool ReadMore();

  InputFile file_;
  std::string buffer_;      // of stored files the piece of text around the line, of others all that came
  std::size_t next_ = 0;    // where in it the next line begins
  bool is_at_end_ = false;  // nothing comes after the buffer
  long number_ = 0;
};

struct FileFingerprint {
  std::uint64_t bytes = 0;
  std::uint32_t crc32 = 0;
};
// Of a whole file, read in pieces. Throws FileError as LineStream does.
FileFingerprint FingerprintOf(const std::string& path);

}  // namespace terse
