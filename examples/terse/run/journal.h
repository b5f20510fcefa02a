#pragma once
// The lines that a run took, on disk before it goes on, so that a run killed at any moment can take them again.
//
// A text file: a line that names the format, then records "NUMBER LENGTH HEADSUM TEXTSUM TEXT\n": the record's number
// from 0, the length of its text in bytes, the CRC-32 of "NUMBER LENGTH" and that of the text as eight hexadecimal
// digits each, and the text. Record 0 is the header, the others are the lines in order.
//
// A record that the end of the file cuts short was in flight, so nothing was answered that rests on it; it is cut off.
// As its head has a checksum of its own, a torn record is told from damage. Whatever else is wrong (another file, a
// byte that changed, a record that is missing, doubled or swapped with another) is refused, and such a file is never
// written to. Records missing at the very end leave no trace: no file alone can tell.
//
// A run of many hours does not replay all its lines: every now and then the journal begins anew, with a header that
// names a snapshot of the state (online_command.cpp).

#include <optional>
#include <string>
#include <string_view>

#include "terse/core/error.h"

namespace terse {

class Journal {
 public:
  // Opens the file, made empty if there is none, locks it (one run at a time, from here on) and reads the header. A
  // file that ends within the header is one of a run killed before its first line: it counts as new (of fewer than 6
  // bytes nobody can tell: it is refused). Throws FileError.
  explicit Journal(const std::string& path);
  // Removes a file that is still empty.
  ~Journal();
  Journal(const Journal&) = delete;
  Journal& operator=(const Journal&) = delete;

  const std::string& Path() const { return path_; }
  bool IsNew() const { return !header_; }
  // Not of a new one.
  const std::string& Header() const { return *header_; }
  // The next record's line (the header is read already), nullopt behind the last whole one. Throws FileError for a file
  // that is damaged or cannot be read.
  std::optional<std::string> ReadLine();
  // After the last one: cuts off what was in flight; how many bytes.
  long CutTail();

  // Begins a new journal.
  void Create(const std::string& header);
  // Begins anew in the place of one that was read or created: the file is the old one or the new one at any moment, and
  // locked. Throws FileError, and the old one stands.
  void Restart(const std::string& header);
  // Up to the end of the last whole record.
  long Bytes() const { return whole_; }
  // `text` is one line. It is on disk after Sync(). What fails leaves the file as it was, if the disk allows.
  void Append(const std::string& text);
  void Sync();

 private:
  void OpenAndLock();
  bool FillTo(std::size_t size);
  void Write(const std::string& bytes);
  FileError Damage(const std::string& what) const;

  std::string path_;
  std::optional<std::string> header_;
  int descriptor_ = -1;
  std::string ahead_;      // read, not yet taken
  std::size_t taken_ = 0;  // of ahead_
  long whole_ = 0;         // bytes up to the end of the last whole record
  long records_ = 0;
};

}  // namespace terse
