#include "terse/core/atomic_file.h"

#include <dirent.h>
#include <fcntl.h>
#include <sys/file.h>
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
#include <random>
#include <utility>

namespace terse {
namespace {

namespace fs = std::filesystem;

FileError CannotWrite(const std::string& path, int error) {
  return FileError(path, 0, "cannot write: " + SystemReason(error));
}

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

constexpr char kMark[] = ".tmp-";
constexpr std::size_t kDigits = 16;

// Nobody can have planted a file under a name that nobody can guess.
std::string TemporaryName(const std::string& target) {
  static constexpr char kHex[] = "0123456789abcdef";
  std::random_device random;
  std::string out = target + kMark;
  for (std::size_t k = 0; k < kDigits; ++k) out += kHex[random() & 15u];
  return out;
}

bool IsTemporaryOf(const std::string& target, const std::string& name) {
  const std::string start = target + kMark;
  return name.size() == start.size() + kDigits && name.compare(0, start.size(), start) == 0 &&
         name.find_first_not_of("0123456789abcdef", start.size()) == std::string::npos;
}

bool Lock(int descriptor) { return ::flock(descriptor, LOCK_EX | LOCK_NB) == 0; }

// A process that was killed left its temporary without the lock.
void RemoveAbandoned(const fs::path& target) {
  const std::string folder = target.has_parent_path() ? target.parent_path().string() : ".";
  DIR* const entries = ::opendir(folder.c_str());
  if (entries == nullptr) return;
  while (const dirent* entry = ::readdir(entries)) {
    if (!IsTemporaryOf(target.filename().string(), entry->d_name)) continue;
    const int descriptor = ::openat(::dirfd(entries), entry->d_name, O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
    if (descriptor < 0) continue;
    struct stat status;
    if (::fstat(descriptor, &status) == 0 && S_ISREG(status.st_mode) && Lock(descriptor)) {
      ::unlinkat(::dirfd(entries), entry->d_name, 0);
    }
    ::close(descriptor);
  }
  ::closedir(entries);
}

}  // namespace

AtomicFile::AtomicFile(const std::string& path) : path_(path) {
  stream_.imbue(std::locale::classic());
  struct stat status;
  const bool is_special = ::stat(path.c_str(), &status) == 0 && !S_ISREG(status.st_mode) && !S_ISDIR(status.st_mode);
  standard_ = DescriptorOf(path);
  if (standard_ >= 0) {
    stream_.rdbuf(&held_back_);
    return;
  }
  if (is_special) {
    descriptor_ = ::open(path.c_str(), O_WRONLY | O_CLOEXEC);
    if (descriptor_ < 0) throw CannotWrite(path, errno);
  } else {
    target_path_ = ResolveTarget(path);
    OpenTemporary();
  }
  buffer_ = std::make_unique<DescriptorBuffer>(descriptor_);
  stream_.rdbuf(buffer_.get());
}

void AtomicFile::OpenTemporary() {
  struct stat old_status;
  const bool replaces = ::stat(target_path_.c_str(), &old_status) == 0;
  // A file that its owner protected stays as it is, though the folder would allow the rename.
  if (replaces && ::access(target_path_.c_str(), W_OK) != 0) throw CannotWrite(path_, errno);
  RemoveAbandoned(target_path_);
  while (true) {
    temporary_path_ = TemporaryName(target_path_);
    slot_ = Register(temporary_path_);
    descriptor_ = ::open(temporary_path_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
    if (descriptor_ < 0) {
      const int error = errno;
      Unregister(slot_);
      temporary_path_.clear();
      if (error != EEXIST) throw CannotWrite(path_, error);
      continue;
    }
    // Between the two another process may have taken it for abandoned. A file system without locks has no such process.
    struct stat status;
    if (!Lock(descriptor_) || (::fstat(descriptor_, &status) == 0 && status.st_nlink > 0)) break;
    Discard();
  }
  // Best effort: a file system without permissions still takes the file.
  if (replaces && ::fchmod(descriptor_, old_status.st_mode & 07777) != 0) errno = 0;
}

AtomicFile::~AtomicFile() { Discard(); }

void AtomicFile::Close() noexcept {
  if (descriptor_ >= 0) ::close(descriptor_);
  descriptor_ = -1;
}

void AtomicFile::Discard() noexcept {
  if (!temporary_path_.empty()) {
    ::unlink(temporary_path_.c_str());
    Unregister(slot_);
    temporary_path_.clear();
  }
  Close();
}

// 0 or an errno. The lock is held until the file has its name.
int AtomicFile::CommitOpen() noexcept {
  if (buffer_->pubsync() != 0) return buffer_->Error();
  if (!stream_) return EIO;
  if (temporary_path_.empty()) return ::close(std::exchange(descriptor_, -1)) == 0 || errno == EINTR ? 0 : errno;
  if (const int error = SyncData(descriptor_); error != 0) return error;
  return ::rename(temporary_path_.c_str(), target_path_.c_str()) == 0 ? 0 : errno;
}

void AtomicFile::Commit() {
  const int error = standard_ >= 0 ? WriteAll(standard_, held_back_.str()) : CommitOpen();
  if (error != 0) {
    Discard();
    throw CannotWrite(path_, error);
  }
  if (!temporary_path_.empty()) {
    Unregister(slot_);
    SyncFolderOf(target_path_);
  }
  temporary_path_.clear();
  Close();
}

void RemoveUncommittedFiles() noexcept {
  const int saved_errno = errno;
  for (Slot& slot : slots) {
    int expected = kInUse;
    if (slot.state.compare_exchange_strong(expected, kRemoving)) ::unlink(slot.path);
  }
  errno = saved_errno;
}

}  // namespace terse
