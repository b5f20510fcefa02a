#include "terse/core/number_text.h"

#include <charconv>
#include <cmath>

namespace terse {

std::string Shortest(double value) {
  if (std::isnan(value)) return "nan";
  char text[32];
  const std::to_chars_result end = std::to_chars(text, text + sizeof(text), value);
  return std::string(text, end.ptr);
}

std::string SixDigits(double value) {
  char text[32];
  const std::to_chars_result end = std::to_chars(text, text + sizeof(text), value, std::chars_format::general, 6);
  return std::string(text, end.ptr);
}

}  // namespace terse
