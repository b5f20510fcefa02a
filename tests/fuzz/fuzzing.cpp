#include "fuzzing.h"

#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>

namespace terse::fuzz {

void Fail(const std::string& message) {
  std::cerr << "fuzzer: " << message << std::endl;
  std::abort();
}

InputFile::InputFile() : descriptor_(::memfd_create("input", MFD_CLOEXEC)) {
  if (descriptor_ < 0) Fail("no file in memory");
  path_ = "/proc/self/fd/" + std::to_string(descriptor_);
}

InputFile::~InputFile() { ::close(descriptor_); }

const std::string& InputFile::With(std::string_view content) {
  if (::ftruncate(descriptor_, 0) != 0 ||
      ::pwrite(descriptor_, content.data(), content.size(), 0) != static_cast<ssize_t>(content.size())) {
    Fail("cannot write the input");
  }
  return path_;
}

ScratchFolder::ScratchFolder() {
  const bool in_memory = std::filesystem::is_directory("/dev/shm");
  path_ = (in_memory ? "/dev/shm" : std::filesystem::temp_directory_path().string()) + "/terse_fuzz_XXXXXX";
  if (::mkdtemp(path_.data()) == nullptr) Fail("no folder for files");
}

ScratchFolder::~ScratchFolder() {
  std::error_code error;
  std::filesystem::remove_all(path_, error);
}

std::string ScratchFolder::With(const std::string& name, std::string_view content) const {
  const std::string path = Path(name);
  std::ofstream(path, std::ios::binary).write(content.data(), static_cast<std::streamsize>(content.size()));
  return path;
}

std::string Content(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

std::vector<Part> Parts(std::string_view input) {
  constexpr std::string_view kMark = "=== ";
  std::vector<Part> out{{"", {}}};
  std::size_t begin = 0;
  for (std::size_t at = 0; at < input.size();) {
    const std::size_t end = std::min(input.find('\n', at), input.size());
    const std::size_t next = std::min(end + 1, input.size());
    if (input.substr(at, kMark.size()) == kMark) {
      out.back().content = input.substr(begin, at - begin);
      out.push_back({std::string(input.substr(at + kMark.size(), end - at - kMark.size())), {}});
      begin = next;
    }
    at = next;
  }
  out.back().content = input.substr(begin);
  return out;
}

}  // namespace terse::fuzz
