#include <fcntl.h>
#include <linux/magic.h>
#include <sys/mman.h>
#include <sys/vfs.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "terse/core/descriptor.h"
#include "terse/core/error.h"
#include "terse/core/panel.h"

namespace terse::internal {
namespace {

constexpr std::uint64_t kAlwaysInMemory = std::uint64_t{64} << 20;  // bytes that are not worth asking for

// /tmp is in memory on many machines.
std::string FolderOfLargeFiles() {
  const char* chosen = std::getenv("TMPDIR");
  return chosen != nullptr && *chosen != '\0' ? chosen : "/var/tmp";
}

int OpenWithoutName(const std::string& folder) {
  const int descriptor = ::open(folder.c_str(), O_TMPFILE | O_RDWR | O_EXCL | O_CLOEXEC, 0600);
  if (descriptor >= 0 || (errno != EOPNOTSUPP && errno != EISDIR)) return descriptor;
  std::string name = folder + "/terse-factor-XXXXXX";  // a file system that has no files without names
  const int named = ::mkostemp(name.data(), O_CLOEXEC);
  if (named >= 0) ::unlink(name.c_str());
  return named;
}

FileError CannotStore(const std::string& reason, std::size_t bytes) {
  return FileError(FolderOfLargeFiles(), 0,
                   "cannot store the factor, " + std::to_string((bytes >> 20) + 1) + " MiB, in a file: " + reason +
                       " (the environment variable TMPDIR names the folder)");
}

// An errno, or 0. A file system that cannot reserve room is refused: what it has no room for would be found out when
// the numbers are gone.
int Reserve(int descriptor, std::size_t bytes) {
  while (::fallocate(descriptor, 0, 0, static_cast<off_t>(bytes)) != 0) {
    if (errno != EINTR) return errno;
  }
  return 0;
}

bool IsInMemory(int descriptor) {
  struct statfs status {};
  return ::fstatfs(descriptor, &status) == 0 && (status.f_type == TMPFS_MAGIC || status.f_type == RAMFS_MAGIC);
}

}  // namespace

PanelFile::PanelFile(std::size_t size) : bytes_(size * sizeof(double)) {
  descriptor_ = OpenWithoutName(FolderOfLargeFiles());
  if (descriptor_ < 0) throw CannotStore(SystemReason(errno), bytes_);
  std::string defect = IsInMemory(descriptor_) ? "the folder is in memory itself" : "";
  if (const int error = defect.empty() ? Reserve(descriptor_, bytes_) : 0; error != 0) defect = SystemReason(error);
  void* mapped = MAP_FAILED;
  if (defect.empty()) {
    mapped = ::mmap(nullptr, bytes_, PROT_READ, MAP_SHARED, descriptor_, 0);
    if (mapped == MAP_FAILED) defect = SystemReason(errno);
  }
  if (!defect.empty()) {
    ::close(descriptor_);
    throw CannotStore(defect, bytes_);
  }
  numbers_ = static_cast<const double*>(mapped);
}

PanelFile::~PanelFile() {
  ::munmap(const_cast<double*>(numbers_), bytes_);
  ::close(descriptor_);
}

void PanelFile::Write(std::size_t at, const double* numbers, std::size_t count) {
  const char* bytes = reinterpret_cast<const char*>(numbers);
  std::size_t left = count * sizeof(double);
  auto offset = static_cast<off_t>(at * sizeof(double));
  while (left > 0) {
    const ssize_t written = ::pwrite(descriptor_, bytes, left, offset);
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) throw CannotStore(SystemReason(written < 0 ? errno : EIO), bytes_);
    bytes += written;
    offset += written;
    left -= static_cast<std::size_t>(written);
  }
}

// Of the pages that hold nothing else.
void PanelFile::Release(std::size_t at, std::size_t count) const noexcept {
  static const auto page = static_cast<std::size_t>(::sysconf(_SC_PAGESIZE)) / sizeof(double);
  const std::size_t begin = (at + page - 1) / page * page, end = (at + count) / page * page;
  if (begin < end) ::madvise(const_cast<double*>(numbers_ + begin), (end - begin) * sizeof(double), MADV_DONTNEED);
}

std::shared_ptr<PanelFile> OpenPanelFile(std::size_t numbers, std::uint64_t most_bytes,
                                         std::uint64_t (*free_memory)()) {
  const std::uint64_t bytes = numbers * sizeof(double);
  if (most_bytes > 0) return bytes > most_bytes ? std::make_shared<PanelFile>(numbers) : nullptr;
  if (bytes <= kAlwaysInMemory) return nullptr;
  const std::uint64_t free = free_memory();
  if (bytes <= free / 2) return nullptr;
  try {
    return std::make_shared<PanelFile>(numbers);
  } catch (const FileError&) {
    if (bytes > free) throw;
    return nullptr;
  }
}

}  // namespace terse::internal
