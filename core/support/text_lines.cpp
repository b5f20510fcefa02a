#include "terse/core/text_lines.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <stdexcept>
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

// Bytes of the character in UTF-8 that the text begins with; 0 if it begins with none.
std::size_t CharacterLength(std::string_view text) {
  const auto byte = [&](std::size_t i) { return i < text.size() ? static_cast<unsigned char>(text[i]) : 0u; };
  const unsigned first = byte(0);
  if (first < 0x80) return 1;
  const std::size_t length = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
  if (first < 0xc2 || first > 0xf4) return 0;
  for (std::size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xc0) != 0x80) return 0;
  }
  // Longer than needed, halves of a pair, or beyond the last character.
  const unsigned second = byte(1);
  const bool is_none = (first == 0xe0 && second < 0xa0) || (first == 0xed && second >= 0xa0) ||
                       (first == 0xf0 && second < 0x90) || (first == 0xf4 && second >= 0x90);
  return is_none ? 0 : length;
}

}  // namespace

TextFile::TextFile(const std::string& path, const ReadLimits& limits) : path_(path) {
  content_ = ReadText(path, limits.most_bytes);
  if (content_.empty()) throw FileError(path, 0, "the file is empty, expected lines of text");
}

void ExpectLineSize(std::size_t bytes, long number, const std::string& path) {
  if (bytes <= kMostLineBytes) return;
  throw FileError(path, number, "the line is too long, expected at most " + std::to_string(kMostLineBytes) + " bytes");
}

bool StripLine(std::string_view raw, long number, const std::string& path, TextLine* line) {
  ExpectLineSize(raw.size(), number, path);
  if (number == 1 && raw.substr(0, 3) == "\xEF\xBB\xBF") raw.remove_prefix(3);  // an editor's byte order mark
  while (!raw.empty() && IsBlank(raw.front())) raw.remove_prefix(1);
  while (!raw.empty() && IsBlank(raw.back())) raw.remove_suffix(1);
  if (raw.empty() || raw[0] == '#' || raw.substr(0, 2) == "//") return false;
  *line = {number, raw};
  return true;
}

std::vector<TextLine> TextFile::Lines() const {
  std::vector<TextLine> lines;
  std::string_view rest = content_;
  TextLine line;
  for (long number = 1; !rest.empty(); ++number) {
    const std::size_t end = rest.find('\n');
    if (StripLine(rest.substr(0, end), number, path_, &line)) lines.push_back(line);
    rest.remove_prefix(end == std::string_view::npos ? rest.size() : end + 1);
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
  more_texts_.clear();
  std::string_view rest = line.text;
  while (true) {
    while (!rest.empty() && IsBlank(rest.front())) rest.remove_prefix(1);
    if (rest.empty()) return;
    const std::string_view field = FirstField(rest);
    if (const auto i = static_cast<std::size_t>(count_); i < kStored) {
      texts_[i] = field;
    } else {
      more_texts_.push_back(field);
    }
    ++count_;
    rest.remove_prefix(field.size());
  }
}

std::string_view Fields::Text(int i) const {
  if (i < 0 || i >= count_)
    throw std::out_of_range("a line of " + std::to_string(count_) + " fields has no such field");
  const auto at = static_cast<std::size_t>(i);
  return at < kStored ? texts_[at] : more_texts_[at - kStored];
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

std::string Quoted(std::string_view text) {
  constexpr std::size_t kLongest = 60;
  std::string out;
  std::size_t i = 0;
  while (i < text.size() && out.size() < kLongest) {
    const std::size_t length = CharacterLength(text.substr(i));
    const auto c = static_cast<unsigned char>(text[i]);
    const bool is_shown = length > 0 && c >= 0x20 && c != 0x7f;
    out += is_shown ? text.substr(i, length) : "?";
    i += std::max(length, std::size_t{1});
  }
  return '"' + out + (i < text.size() ? "..." : "") + '"';
}

}  // namespace terse
