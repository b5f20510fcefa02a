#include "terse/core/read_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>

#include "terse/core/descriptor.h"

namespace terse {
namespace {

FileError CannotRead(const std::string& path) { return FileError(path, 0, "cannot read: " + SystemReason(errno)); }

struct stat StatusOf(int descriptor, const std::string& path) {
  struct stat status {};
  if (::fstat(descriptor, &status) != 0) throw CannotRead(path);
  return status;
}

FileVersion VersionOf(const struct stat& status) {
  return {static_cast<std::uint64_t>(status.st_size),
          std::int64_t{status.st_mtim.tv_sec} * 1000000000 + status.st_mtim.tv_nsec};
}

std::string Mebibytes(std::uint64_t bytes) {
  constexpr std::uint64_t kMebibyte = std::uint64_t{1} << 20;
  return bytes % kMebibyte == 0 ? std::to_string(bytes / kMebibyte) + " MiB" : std::to_string(bytes) + " bytes";
}

int Open(const std::string& path) {
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor >= 0) return descriptor;
  throw errno == ENOENT ? FileError(path, 0, "the file does not exist") : CannotRead(path);
}

}  // namespace

InputFile::InputFile(const std::string& path) : InputFile(path, Open(path)) {
  const struct stat status = StatusOf(descriptor_, path);
  if (S_ISDIR(status.st_mode)) throw FileError(path, 0, "cannot read: it is a folder, expected a file");
  is_stored_ = S_ISREG(status.st_mode);
  version_ = VersionOf(status);
}

InputFile::~InputFile() { ::close(descriptor_); }

std::size_t InputFile::Read(char* bytes, std::size_t size) {
  const long count = ReadSome(descriptor_, bytes, size);
  if (count < 0) throw CannotRead(path_);
  return static_cast<std::size_t>(count);
}

void InputFile::ExpectUnchanged(const FileVersion& since) const {
  if (!is_stored_ || VersionOf(StatusOf(descriptor_, path_)) == since) return;
  throw FileError(path_, 0, "the file was changed while it was read");
}

void InputFile::Rewind() {
  if (::lseek(descriptor_, 0, SEEK_SET) != 0) throw CannotRead(path_);
}

FileError TooLarge(const std::string& path, std::uint64_t most_bytes) {
  return FileError(path, 0, "the file is too large or has no end, expected at most " + Mebibytes(most_bytes));
}

void ExpectText(const std::string& path, std::string_view content, long first_line) {
  const std::size_t nul = content.find('\0');
  if (nul == std::string_view::npos) return;
  const auto line = std::count(content.begin(), content.begin() + static_cast<std::ptrdiff_t>(nul), '\n');
  throw FileError(path, first_line + static_cast<long>(line), "a binary file (it holds a zero byte), expected text");
}

std::string ReadAll(const std::string& path, const ReadLimits& limits) {
  InputFile file(path);
  std::string content;
  if (file.IsStored()) {
    if (file.Version().bytes > limits.most_bytes) throw TooLarge(path, limits.most_bytes);
    content.reserve(file.Version().bytes + 1);  // it is on the disk; a sparse file costs no memory until it is read
  }
  std::array<char, 1 << 16> chunk;
  bool is_checked = !limits.check_start;
  const auto check = [&] {
    is_checked = true;
    limits.check_start(content);
  };
  while (const std::size_t count = file.Read(chunk.data(), chunk.size())) {
    if (content.size() + count > limits.most_bytes) throw TooLarge(path, limits.most_bytes);
    content.append(chunk.data(), count);
    if (!is_checked && content.size() >= chunk.size()) check();
  }
  if (!is_checked) check();
  return content;
}

std::string ReadText(const std::string& path, std::uint64_t most_bytes) {
  std::string content = ReadAll(path, {most_bytes, [&](std::string_view start) { ExpectText(path, start); }});
  ExpectText(path, content);
  return content;
}

}  // namespace terse
