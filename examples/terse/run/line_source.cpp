#include "run/line_source.h"

#include <unistd.h>

#include <algorithm>
#include <cerrno>

#include "terse/core/descriptor.h"
#include "terse/core/error.h"
#include "terse/core/limits.h"
#include "terse/core/measurement_line.h"

namespace terse {
namespace {

constexpr std::size_t kChunk = 1 << 16, kMostAhead = 10000;

}  // namespace

std::string Trimmed(const std::string& text) {
  const std::size_t first = text.find_first_not_of(kBlanks);
  return first == std::string::npos ? "" : text.substr(first, text.find_last_not_of(kBlanks) - first + 1);
}

int LineSource::FindDimension() {
  std::size_t bytes = 0;
  for (InputLine line; Read(line);) {
    if (!line.torn && (line.text.empty() || line.text[0] == '#' || line.text == "FLUSH")) continue;
    ahead_.push_back(line);
    if (const int dimension = DimensionOfLine(line.text); dimension != 0) return dimension;
    bytes += line.text.size();
    if (ahead_.size() > kMostAhead || bytes > kMostLineBytes) {
      throw FileError(kName, line.number,
                      "no measurement among " + std::to_string(ahead_.size()) + " lines; expected one, or --dimension");
    }
  }
  return 0;
}

bool LineSource::Next(InputLine& line) {
  if (ahead_.empty()) return Read(line);
  line = std::move(ahead_.front());
  ahead_.pop_front();
  return true;
}

bool LineSource::Read(InputLine& line) {
  std::string text;
  while (taken_ < buffer_.size() || Fill()) {
    const std::size_t end = buffer_.find('\n', taken_), last = std::min(end, buffer_.size());
    text.append(buffer_, taken_, last - taken_);
    if (text.size() > kMostLineBytes) {
      throw FileError(kName, number_ + 1,
                      "longer than " + std::to_string(kMostLineBytes) + " bytes, expected lines of text");
    }
    taken_ = end == std::string::npos ? last : end + 1;
    if (end == std::string::npos) continue;
    line = {Trimmed(text), ++number_, false};
    return true;
  }
  if (text.empty()) return false;
  line = {Trimmed(text), ++number_, true};
  return true;
}

// False at the end of the input.
bool LineSource::Fill() {
  buffer_.resize(kChunk);
  const long count = ReadSome(STDIN_FILENO, buffer_.data(), buffer_.size());
  const int error = errno;
  buffer_.resize(static_cast<std::size_t>(std::max(count, 0L)));
  taken_ = 0;
  if (count < 0) throw FileError(kName, number_ + 1, "cannot read: " + SystemReason(error));
  return count > 0;
}

}  // namespace terse
