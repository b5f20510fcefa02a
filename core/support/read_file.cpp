#include "terse/core/read_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>

#include "terse/core/descriptor.h"
#include "terse/core/error.h"

namespace terse {
namespace {

std::string ErrorText() { return SystemReason(errno); }

class Descriptor {
 public:
  explicit Descriptor(const std::string& path) : number_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
    if (number_ >= 0) return;
    throw FileError(path, 0, errno == ENOENT ? "the file does not exist" : "cannot read: " + ErrorText());
  }
  ~Descriptor() { ::close(number_); }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int Number() const { return number_; }

 private:
  int number_;
};

std::string Mebibytes(std::uint64_t bytes) {
  constexpr std::uint64_t kMebibyte = std::uint64_t{1} << 20;
  return bytes % kMebibyte == 0 ? std::to_string(bytes / kMebibyte) + " MiB" : std::to_string(bytes) + " bytes";
}

FileError TooLarge(const std::string& path, std::uint64_t most) {
  return FileError(path, 0, "the file is too large or has no end, expected at most " + Mebibytes(most));
}

void ExpectText(const std::string& path, std::string_view content) {
  const std::size_t nul = content.find('\0');
  if (nul == std::string_view::npos) return;
  const auto line = 1 + std::count(content.begin(), content.begin() + static_cast<std::ptrdiff_t>(nul), '\n');
  throw FileError(path, static_cast<long>(line), "a binary file (it holds a zero byte), expected text");
}

}  // namespace

std::string ReadAll(const std::string& path, const ReadLimits& limits) {
  const Descriptor file(path);
  struct stat status {};
  if (::fstat(file.Number(), &status) != 0) throw FileError(path, 0, "cannot read: " + ErrorText());
  if (S_ISDIR(status.st_mode)) throw FileError(path, 0, "cannot read: it is a folder, expected a file");
  std::string content;
  if (S_ISREG(status.st_mode)) {
    const auto size = static_cast<std::uint64_t>(status.st_size);
    if (size > limits.most_bytes) throw TooLarge(path, limits.most_bytes);
    content.reserve(size + 1);  // it is on the disk; a sparse file costs no memory until it is read
  }
  std::array<char, 1 << 16> chunk;
  bool is_checked = !limits.check_start;
  const auto check = [&] {
    is_checked = true;
    limits.check_start(content);
  };
  while (true) {
    const long count = ReadSome(file.Number(), chunk.data(), chunk.size());
    if (count < 0) throw FileError(path, 0, "cannot read: " + ErrorText());
    if (count == 0) break;
    if (content.size() + static_cast<std::uint64_t>(count) > limits.most_bytes) throw TooLarge(path, limits.most_bytes);
    content.append(chunk.data(), static_cast<std::size_t>(count));
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
