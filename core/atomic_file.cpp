#include "terse/core/atomic_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <locale>
#include <system_error>

namespace terse {
namespace {

namespace fs = std::filesystem;

std::string Reason(int error) { return std::system_category().message(error); }

// The temporaries that a signal handler has to remove. Slots are claimed by compare-and-swap, so neither side
// ever waits. A slot that the handler took (kRemoving) is never used again.
enum SlotState : int { kFree, kFilling, kInUse, kRemoving };
struct Slot {
  std::atomic<int> state{kFree};
  char path[4096] = {};
};
constexpr int kSlots = 64;
std::array<Slot, kSlots> slots;
static_assert(std::atomic<int>::is_always_lock_free, "a signal handler must not block");

// -1 if the table is full or the path does not fit: the file is then merely not removed by a signal handler.
int Register(const std::string& path) {
  if (path.size() >= sizeof(Slot::path)) return -1;
  for (int i = 0; i < kSlots; ++i) {
    Slot& slot = slots[static_cast<std::size_t>(i)];
    int expected = kFree;
    if (!slot.state.compare_exchange_strong(expected, kFilling)) continue;
    std::memcpy(slot.path, path.c_str(), path.size() + 1);
    slot.state.store(kInUse);
    return i;
  }
  return -1;
}

void Unregister(int i) noexcept {
  if (i < 0) return;
  int expected = kInUse;
  slots[static_cast<std::size_t>(i)].state.compare_exchange_strong(expected, kFree);
}

// The descriptor behind /dev/stdout and the like, else -1. Opening such a path anew would give the file behind it a
// second offset, and renaming over it would lose what the process writes later.
int DescriptorOf(const std::string& path) {
  if (path == "/dev/stdout") return STDOUT_FILENO;
  if (path == "/dev/stderr") return STDERR_FILENO;
  int descriptor = -1;
  if (path.rfind("/dev/fd/", 0) == 0) std::from_chars(path.data() + 8, path.data() + path.size(), descriptor);
  return descriptor;
}

// The file to replace, links resolved. Throws if there is no place for it.
std::string ResolveTarget(const std::string& path) {
  if (path.empty()) throw FileError("(no name)", 0, "cannot write a file without a name");
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (fs::is_directory(status)) throw FileError(path, 0, "cannot write: it is a folder");
  if (fs::exists(status)) {
    const fs::path target = fs::canonical(path, error);
    if (error) throw FileError(path, 0, "cannot write: " + error.message());
    return target.string();
  }
  if (fs::is_symlink(fs::symlink_status(path, error))) {
    throw FileError(path, 0, "cannot write: it is a symbolic link that leads nowhere");
  }
  fs::path parent = fs::path(path).parent_path();
  if (parent.empty()) parent = ".";
  const fs::file_status parent_status = fs::status(parent, error);
  if (parent_status.type() == fs::file_type::not_found) {
    throw FileError(path, 0, "cannot write: the folder " + parent.string() + " does not exist");
  }
  if (fs::exists(parent_status) && !fs::is_directory(parent_status)) {
    throw FileError(path, 0, "cannot write: " + parent.string() + " is not a folder");
  }
  if (fs::path(path).filename().empty()) throw FileError(path, 0, "cannot write: it names a folder");
  return path;
}

bool FlushToDisk(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
  if (descriptor < 0) return false;
  // Some file systems have no fsync (EINVAL): the rename is atomic all the same.
  const bool flushed = ::fsync(descriptor) == 0 || errno == EINVAL || errno == ENOTSUP;
  const int error = errno;
  ::close(descriptor);
  errno = error;
  return flushed;
}

}  // namespace

AtomicFile::AtomicFile(const std::string& path) : path_(path) {
  stream_.imbue(std::locale::classic());
  struct stat status;
  const bool is_special = ::stat(path.c_str(), &status) == 0 && !S_ISREG(status.st_mode) && !S_ISDIR(status.st_mode);
  errno = 0;
  descriptor_ = DescriptorOf(path);
  if (descriptor_ >= 0) {
    static_cast<std::ostream&>(stream_).rdbuf(&held_back_);
    return;
  }
  if (is_special) {
    stream_.open(path, std::ios::binary);
    if (!stream_) throw FileError(path, 0, "cannot write: " + Reason(errno));
    return;
  }
  target_path_ = ResolveTarget(path);
  OpenTemporary();
}

void AtomicFile::OpenTemporary() {
  static std::atomic<unsigned> counter{0};
  struct stat old_status;
  const bool replaces = ::stat(target_path_.c_str(), &old_status) == 0;
  // A file that its owner protected stays as it is, though the folder would allow the rename.
  if (replaces && ::access(target_path_.c_str(), W_OK) != 0)
    throw FileError(path_, 0, "cannot write: " + Reason(errno));
  int descriptor = -1;
  do {
    temporary_path_ = target_path_ + ".tmp-" + std::to_string(::getpid()) + "-" + std::to_string(counter++);
    slot_ = Register(temporary_path_);
    descriptor = ::open(temporary_path_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor < 0) {
      const int error = errno;
      Unregister(slot_);
      if (error != EEXIST) throw FileError(path_, 0, "cannot write: " + Reason(error));
    }
  } while (descriptor < 0);
  // Best effort: a file system without permissions still takes the file.
  if (replaces && ::fchmod(descriptor, old_status.st_mode & 07777) != 0) errno = 0;
  ::close(descriptor);
  stream_.open(temporary_path_, std::ios::binary | std::ios::out | std::ios::trunc);
  if (!stream_) {
    const int error = errno;
    Discard();
    throw FileError(path_, 0, "cannot write: " + Reason(error));
  }
}

AtomicFile::~AtomicFile() { Discard(); }

void AtomicFile::Discard() noexcept {
  if (temporary_path_.empty()) return;
  ::unlink(temporary_path_.c_str());
  Unregister(slot_);
  temporary_path_.clear();
}

bool AtomicFile::WriteToDescriptor() {
  const std::string text = held_back_.str();
  for (std::size_t done = 0; done < text.size();) {
    const ssize_t count = ::write(descriptor_, text.data() + done, text.size() - done);
    if (count < 0 && errno != EINTR) return false;
    if (count > 0) done += static_cast<std::size_t>(count);
  }
  return true;
}

void AtomicFile::Commit() {
  errno = 0;
  if (descriptor_ >= 0) {
    if (!WriteToDescriptor()) throw FileError(path_, 0, "cannot write: " + Reason(errno));
    return;
  }
  stream_.flush();
  bool written = stream_.good();
  stream_.close();
  written = written && stream_.good();
  if (temporary_path_.empty()) {
    if (!written) throw FileError(path_, 0, "cannot write: " + Reason(errno != 0 ? errno : EIO));
    return;
  }
  if (!written || !FlushToDisk(temporary_path_) || ::rename(temporary_path_.c_str(), target_path_.c_str()) != 0) {
    const int error = errno != 0 ? errno : EIO;
    Discard();
    throw FileError(path_, 0, "cannot write: " + Reason(error));
  }
  Unregister(slot_);
  temporary_path_.clear();
}

void RemoveUncommittedFiles() noexcept {
  const int saved_errno = errno;
  for (Slot& slot : slots) {
    int expected = kInUse;
    if (slot.state.compare_exchange_strong(expected, kRemoving)) ::unlink(slot.path);
  }
  errno = saved_errno;
}

std::string Shortest(double value) {
  if (std::isnan(value)) return "nan";
  char text[32];
  const std::to_chars_result end = std::to_chars(text, text + sizeof(text), value);
  return std::string(text, end.ptr);
}

}  // namespace terse
