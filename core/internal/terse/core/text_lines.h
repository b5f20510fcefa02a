#pragma once
// Text files as lines and fields, read strictly and independently of the locale.

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "terse/core/error.h"
#include "terse/core/read_file.h"

namespace terse {

struct TextLine {
  long number = 0;        // from 1
  std::string_view text;  // without the line end, CR or LF
};

// Throws FileError if so many bytes are beyond kMostLineBytes.
void ExpectLineSize(std::size_t bytes, long number, const std::string& path);
// The line without blanks around it; false if it is blank or a comment (# or // first). Throws as ExpectLineSize does.
bool StripLine(std::string_view raw, long number, const std::string& path, TextLine* line);

// A file read whole. Throws FileError if it is missing, a folder, unreadable, empty, too large, binary (holds NUL
// bytes) or has a line beyond kMostLineBytes.
class TextFile {
 public:
  explicit TextFile(const std::string& path, const ReadLimits& limits = {});
  TextFile(const TextFile&) = delete;
  TextFile& operator=(const TextFile&) = delete;
  const std::string& Path() const { return path_; }
  // Lines that are neither blank nor comments. The views live as long as the file.
  std::vector<TextLine> Lines() const;

 private:
  std::string path_, content_;
};

// The text up to the first blank.
std::string_view FirstField(std::string_view text);

// True if the text is a number as Fields::Number reads it, finite or not.
bool IsNumber(std::string_view text);

// The fields of one line, split at blanks. An object serves many lines in turn. Fields count from 0, in messages
// from 1; `name` goes into the messages only.
class Fields {
 public:
  explicit Fields(const std::string& path) : path_(path) {}
  // The views must outlive the use of the fields.
  void Split(const TextLine& line);
  int Count() const { return count_; }
  // Throws std::out_of_range unless 0 <= i < Count().
  std::string_view Text(int i) const;
  // Finite, in decimal notation; a leading + is fine.
  double Number(int i, const char* name) const;
  std::int64_t Integer(int i, const char* name) const;
  FileError Error(const std::string& cause) const { return FileError(path_, line_, cause); }
  long LineNumber() const { return line_; }

 private:
  // More than any line but a FIX of many poses, which alone costs an allocation.
  static constexpr std::size_t kStored = 40;
  FileError FieldError(int i, const char* name, const std::string& cause) const;

  const std::string& path_;
  long line_ = 0;
  int count_ = 0;
  std::array<std::string_view, kStored> texts_;
  std::vector<std::string_view> more_texts_;  // from field kStored on
};

// Text in quotes for a message, cut if long, unprintable bytes as "?".
std::string Quoted(std::string_view text);

}  // namespace terse
