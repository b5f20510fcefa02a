#pragma once
// A file that appears whole or not at all.

#include <memory>
#include <ostream>
#include <sstream>
#include <string>

#include "terse/core/descriptor.h"
#include "terse/core/error.h"

namespace terse {

// Writes to a temporary neighbour of `path` (PATH.tmp-RANDOM, created exclusively and locked while it is written);
// Commit() flushes and renames it into place. Destroyed without Commit (an exception, Ctrl-C handled by the caller), it
// removes the temporary; one that a killed process left is removed by the next that writes to the same path. Throws
// FileError.
// A replaced file keeps its permissions; a symbolic link stays one and its target is replaced. What is no regular
// file (a terminal, a pipe) is written directly; what is meant for /dev/stdout leaves by the open descriptor at
// Commit().
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
  void OpenTemporary();
  int CommitOpen() noexcept;
  void Close() noexcept;
  void Discard() noexcept;

  std::string path_;            // as the caller named it, for messages
  std::string target_path_;     // links resolved
  std::string temporary_path_;  // empty: written directly
  int standard_ = -1;           // the descriptor behind /dev/stdout and the like
  std::stringbuf held_back_;    // what goes there
  int descriptor_ = -1;         // of what was opened here
  std::unique_ptr<DescriptorBuffer> buffer_;
  int slot_ = -1;  // in the table of RemoveUncommittedFiles
  std::ostream stream_{nullptr};
};

// Removes every temporary not committed yet. Async-signal-safe, for a SIGINT handler that then exits.
void RemoveUncommittedFiles() noexcept;

}  // namespace terse
