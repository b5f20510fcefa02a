#pragma once
// A file that appears whole or not at all.

#include <fstream>
#include <string>

#include "terse/core/error.h"

namespace terse {

// Writes to a temporary neighbour of `path`; Commit() flushes and renames it into place. Destroyed without
// Commit (an exception, Ctrl-C handled by the caller), it removes the temporary. Throws FileError.
class AtomicFile {
 public:
  explicit AtomicFile(const std::string& path);
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;
  // Imbued with the classic locale.
  std::ostream& Stream() { return stream_; }
  void Commit();

 private:
  std::string path_, temporary_path_;
  std::ofstream stream_;
};

// Removes every temporary not committed yet. Async-signal-safe, for a SIGINT handler that then exits.
void RemoveUncommittedFiles() noexcept;

// The shortest decimal text that reads back as the same double ("nan" and "inf" as such), whatever the locale.
std::string Shortest(double value);

}  // namespace terse
