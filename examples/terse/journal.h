#pragma once
// The lines that a run took, on disk before it goes on, so that a run killed at any moment can take them again.
//
// A text file: a line that names the format, then records "LENGTH CRC TEXT\n" with the text's length in bytes, its
// CRC-32 as eight hexadecimal digits, and the text. The first record is the header, the others are the lines in order.
// A record that the end of the file cuts short was in flight and is cut off. Whatever else is wrong (another file,
// damage with whole records behind it) is refused, and such a file is never written to.
//
// A run of many hours replays all its lines. A record with a snapshot of the state could stand for those before it:
// Lines() would then begin behind the last one.

#include <string>
#include <vector>

namespace terse {

class Journal {
 public:
  // Reads the file if there is one; an empty file counts as none. The file is locked: one run at a time. Throws
  // FileError.
  explicit Journal(const std::string& path);
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  const std::string& Path() const { return path_; }
  bool IsNew() const { return descriptor_ < 0; }
  const std::string& Header() const { return header_; }
  const std::vector<std::string>& Lines() const { return lines_; }

  // Of a new journal: writes it whole or not at all.
  void Create(const std::string& header);
  // Cuts off what was in flight; how many bytes.
  long CutTail();
  // `text` is one line. It is on disk after Sync().
  void Append(const std::string& text);
  void Sync();

 private:
  void Open();
  void Parse(const std::string& content);

  std::string path_, header_;
  std::vector<std::string> lines_;
  long whole_ = 0, size_ = 0;  // bytes: up to the end of the last whole record, and of the file
  int descriptor_ = -1;
};

}  // namespace terse
