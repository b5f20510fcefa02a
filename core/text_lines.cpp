#include "text_lines.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <system_error>

namespace terse {
namespace {

bool IsBlank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

// from_chars takes no leading +.
std::string_view WithoutPlus(std::string_view text) {
  if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
  return text;
}

template <class Value>
std::errc Parse(std::string_view text, Value* value) {
  text = WithoutPlus(text);
  const std::from_chars_result result = std::from_chars(text.data(), text.data() + text.size(), *value);
  if (result.ec == std::errc() && result.ptr != text.data() + text.size()) return std::errc::invalid_argument;
  return result.ec;
}

}  // namespace

std::string ReadAll(const std::string& path) {
  namespace fs = std::filesystem;
  std::error_code error;
  const fs::file_status status = fs::status(path, error);
  if (status.type() == fs::file_type::not_found) throw FileError(path, 0, "the file does not exist");
  if (fs::is_directory(status)) throw FileError(path, 0, "cannot read: it is a folder, expected a file");
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) throw FileError(path, 0, "cannot read: " + std::system_category().message(errno));
  std::string content;
  if (fs::is_regular_file(status)) {
    const std::uintmax_t size = fs::file_size(path, error);
    if (!error) content.reserve(static_cast<std::size_t>(size) + 1);
  }
  std::array<char, 1 << 16> chunk;
  while (true) {
    const ssize_t count = ::read(descriptor, chunk.data(), chunk.size());
    if (count < 0 && errno == EINTR) continue;
    if (count < 0) {
      const int failure = errno;
      ::close(descriptor);
      throw FileError(path, 0, "cannot read: " + std::system_category().message(failure));
    }
    if (count == 0) break;
    content.append(chunk.data(), static_cast<std::size_t>(count));
  }
  ::close(descriptor);
  return content;
}

TextFile::TextFile(const std::string& path) : path_(path), content_(ReadAll(path)) {
  const std::size_t nul = content_.find('\0');
  if (nul != std::string::npos) {
    long line = 1;
    for (std::size_t i = 0; i < nul; ++i) line += content_[i] == '\n';
    throw FileError(path, line, "a binary file (it holds a zero byte), expected text");
  }
  if (content_.empty()) throw FileError(path, 0, "the file is empty, expected lines of text");
}

std::vector<TextLine> TextFile::Lines() const {
  std::vector<TextLine> lines;
  std::string_view rest = content_;
  if (rest.substr(0, 3) == "\xEF\xBB\xBF") rest.remove_prefix(3);  // an editor's byte order mark
  for (long number = 1; !rest.empty(); ++number) {
    const std::size_t end = rest.find('\n');
    std::string_view text = rest.substr(0, end);
    rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
    while (!text.empty() && IsBlank(text.front())) text.remove_prefix(1);
    while (!text.empty() && IsBlank(text.back())) text.remove_suffix(1);
    if (text.empty() || text[0] == '#' || text.substr(0, 2) == "//") continue;
    lines.push_back({number, text});
  }
  return lines;
}

std::string_view FirstField(std::string_view text) {
  std::size_t end = 0;
  while (end < text.size() && !IsBlank(text[end])) ++end;
  return text.substr(0, end);
}

bool IsNumber(std::string_view text) {
  double value = 0;
  return Parse(text, &value) != std::errc::invalid_argument;
}

void Fields::Split(const TextLine& line) {
  line_ = line.number;
  count_ = 0;
  std::string_view rest = line.text;
  while (true) {
    while (!rest.empty() && IsBlank(rest.front())) rest.remove_prefix(1);
    if (rest.empty()) return;
    const std::string_view field = FirstField(rest);
    if (count_ < kMostStored) texts_[static_cast<std::size_t>(count_)] = field;
    ++count_;
    rest.remove_prefix(field.size());
  }
}

FileError Fields::FieldError(int i, const char* name, const std::string& cause) const {
  return Error("field " + std::to_string(i + 1) + " (" + name + ") reads " + Quoted(Text(i)) + ": " + cause);
}

double Fields::Number(int i, const char* name) const {
  double value = 0;
  const std::errc error = Parse(Text(i), &value);
  if (error == std::errc::invalid_argument) throw FieldError(i, name, "not a number, expected a decimal one");
  if (error == std::errc::result_out_of_range)
    throw FieldError(i, name, "beyond the range of a double, expected less than 1.8e308");
  if (!std::isfinite(value)) throw FieldError(i, name, "not finite, expected a finite number");
  return value;
}

std::int64_t Fields::Integer(int i, const char* name) const {
  std::int64_t value = 0;
  const std::errc error = Parse(Text(i), &value);
  if (error == std::errc::invalid_argument) throw FieldError(i, name, "not an integer, expected a whole number");
  if (error == std::errc::result_out_of_range) throw FieldError(i, name, "beyond a signed 64-bit integer");
  return value;
}

std::string Rounded(double value) {
  char text[32];
  const std::to_chars_result end = std::to_chars(text, text + sizeof(text), value, std::chars_format::general, 6);
  return std::string(text, end.ptr);
}

std::string Quoted(std::string_view text) {
  constexpr std::size_t kLongest = 60;
  std::string out(text.substr(0, kLongest));
  for (char& c : out) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = '?';
  }
  return '"' + out + (text.size() > kLongest ? "..." : "") + '"';
}

}  // namespace terse
