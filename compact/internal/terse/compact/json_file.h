#pragma once
// JSON from files: bounded in size and depth, and what is wrong with it as a FileError; and JSON into files.

#include <cstdint>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <string_view>

#include "terse/core/error.h"

namespace terse {

// One JSON value; Json is nlohmann::json or nlohmann::ordered_json. `line` is where the text begins in the file. Throws
// FileError with the line of the mistake: no JSON, cut off, a number beyond a double, or nested deeper than
// kMostJsonDepth, which is found before anything is built of it.
template <class Json>
Json ParseJson(std::string_view text, const std::string& path, long line = 1);

// The same of a file that is to hold an object. `what` it is, for messages: "thresholds". `text` becomes all of the
// file, if it is given. Throws FileError.
template <class Json>
Json ReadJsonObject(const std::string& path, const std::string& what, std::string* text = nullptr);

// The same without what stands behind any other key, at whatever depth: that is read and checked, but takes no memory.
nlohmann::json ReadJsonObject(const std::string& path, const std::string& what, const std::set<std::string>& keys);

// The whole number that a value is. Throws FileError if it is none or beyond 64 bits; nlohmann's get() converts what
// does not fit, which has no defined result.
template <class Json>
std::int64_t WholeNumber(const Json& value, const std::string& path, long line = 0) {
  const bool fits =
      value.is_number_unsigned() ? value.template get<std::uint64_t>() <= INT64_MAX : value.is_number_integer();
  if (fits) return value.template get<std::int64_t>();
  std::string text = value.dump();
  if (text.size() > 40) text = text.substr(0, 40) + "...";
  throw FileError(path, line, text + ", expected a whole number");
}

// Indented; written whole or not at all. Throws FileError.
void WriteJson(const nlohmann::ordered_json& json, const std::string& path);

}  // namespace terse
