#pragma once
// What the fuzzers share: inputs as files that cost no disk, and what readers may throw.

#include <cstddef>
#include <cstdint>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "terse/core/error.h"

namespace terse::fuzz {

// Ends the process with the message, which the fuzzer reports as a crash.
[[noreturn]] void Fail(const std::string& message);
inline void Expect(bool condition, const char* message) {
  if (!condition) Fail(message);
}

// A file in memory; it has a path as long as it lives.
class InputFile {
 public:
  InputFile();
  ~InputFile();
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;
  const std::string& Path() const { return path_; }
  // The path of the file, which then holds this.
  const std::string& With(std::string_view content);

 private:
  int descriptor_;
  std::string path_;
};

// A folder of the process in memory (/dev/shm) if there is one, removed at its end.
class ScratchFolder {
 public:
  ScratchFolder();
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;
  std::string Path(const std::string& name = "") const { return name.empty() ? path_ : path_ + '/' + name; }
  // The path of the file, which then holds this.
  std::string With(const std::string& name, std::string_view content) const;

 private:
  std::string path_;
};

std::string Content(const std::string& path);

// Whether `work` was done. It may refuse with the errors that users are told of; others pass and end the fuzzer.
template <class Work>
bool Done(const Work& work) {
  try {
    work();
    return true;
  } catch (const FileError&) {
  } catch (const NumericalError&) {
  } catch (const std::invalid_argument&) {
  }
  return false;
}

// The parts of an input, which lines "=== NAME" begin; what stands before the first is the part named "".
struct Part {
  std::string name;
  std::string_view content;
};
std::vector<Part> Parts(std::string_view input);

inline std::string_view AsText(const std::uint8_t* data, std::size_t size) {
  return {reinterpret_cast<const char*>(data), size};
}

// Equal, or both not numbers.
inline bool Same(double a, double b) { return a == b || (a != a && b != b); }
// Up to rounding.
inline bool Near(double a, double b, double tolerance = 1e-12) {
  const double scale = 1 + (a < 0 ? -a : a);
  const double difference = a < b ? b - a : a - b;
  return difference <= tolerance * scale;
}

}  // namespace terse::fuzz
