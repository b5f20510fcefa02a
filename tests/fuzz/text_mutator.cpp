#include "text_mutator.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <string_view>
#include <utility>

namespace terse::fuzz {
namespace {

using std::size_t;

constexpr std::string_view kParting = " \t\r\n,:[]{}\"";
constexpr std::array kFields = {"0",
                                "1",
                                "-1",
                                "2",
                                "7",
                                "1e308",
                                "-1e308",
                                "1e309",
                                "1e-308",
                                "5e-324",
                                "1e160",
                                "1e19",
                                "1e9",
                                "0.5",
                                "nan",
                                "inf",
                                "-inf",
                                "abc",
                                "",
                                "+",
                                "3.15",
                                "9007199254740993",
                                "null",
                                "true",
                                "[]",
                                "{}",
                                "1e300",
                                "-1e300",
                                "1e-12",
                                "-0",
                                "0x10",
                                "1,5",
                                "9223372036854775807",
                                "\"x\"",
                                "99999",
                                "-99999",
                                "FLUSH",
                                "# gone ",
                                "FIX",
                                "\xff",
                                "1e7",
                                "-5",
                                "100",
                                "-9223372036854775808"};

size_t Below(size_t n, std::mt19937_64& random) { return n == 0 ? 0 : static_cast<size_t>(random() % n); }

struct Range {
  size_t begin = 0, end = 0;
};

Range LineAt(const std::string& text, size_t at) {
  const size_t before = at == 0 ? std::string::npos : text.rfind('\n', at - 1);
  const size_t end = text.find('\n', at);
  return {before == std::string::npos ? 0 : before + 1, end == std::string::npos ? text.size() : end + 1};
}

// The one at the place or behind it.
Range FieldAt(const std::string& text, size_t at) {
  size_t begin = std::min(text.find_first_not_of(kParting, at), text.size());
  while (begin > 0 && kParting.find(text[begin - 1]) == std::string_view::npos) --begin;
  return {begin, std::min(text.find_first_of(kParting, begin), text.size())};
}

void Swap(std::string& text, Range a, Range b) {
  if (a.begin > b.begin) std::swap(a, b);
  if (a.end > b.begin) return;
  const std::string first = text.substr(a.begin, a.end - a.begin), second = text.substr(b.begin, b.end - b.begin);
  text.replace(b.begin, b.end - b.begin, first);
  text.replace(a.begin, a.end - a.begin, second);
}

std::string Taken(const std::string& text, Range range) { return text.substr(range.begin, range.end - range.begin); }

}  // namespace

std::string MutateText(std::string text, std::mt19937_64& random) {
  const auto somewhere = [&] { return Below(text.size(), random); };
  const size_t at = somewhere(), other = somewhere();
  const Range line = LineAt(text, at), field = FieldAt(text, at);
  switch (Below(14, random)) {
    case 0: text.erase(line.begin, line.end - line.begin); break;
    case 1: text.insert(LineAt(text, other).begin, Taken(text, line)); break;
    case 2: Swap(text, line, LineAt(text, other)); break;
    case 3: text.erase(field.begin, field.end - field.begin); break;
    case 4: text.insert(FieldAt(text, other).begin, Taken(text, field) + ' '); break;
    case 5: Swap(text, field, FieldAt(text, other)); break;
    case 6: text.replace(field.begin, field.end - field.begin, Taken(text, FieldAt(text, other))); break;
    case 7:
      if (!text.empty()) text[at] = static_cast<char>(text[at] ^ 1 << Below(8, random));
      break;
    case 8: text.erase(at, Below(20, random)); break;
    case 9: text.resize(at); break;
    case 10: {  // the same line many times
      const std::string repeated = Taken(text, line);
      for (size_t k = Below(60, random); k > 0; --k) text.insert(line.begin, repeated);
      break;
    }
    default: text.replace(field.begin, field.end - field.begin, kFields[Below(kFields.size(), random)]); break;
  }
  return text;
}

}  // namespace terse::fuzz
