#include "terse/compact/json_file.h"

#include <algorithm>
#include <cstddef>

#include "terse/core/atomic_file.h"
#include "terse/core/read_file.h"

namespace terse {
namespace {

using std::size_t;

long LineAt(std::string_view text, size_t byte, long first_line) {
  const std::string_view before = text.substr(0, std::min(byte, text.size()));
  return first_line + static_cast<long>(std::count(before.begin(), before.end(), '\n'));
}

// nlohmann's parser keeps its own stack, but copies, prints and some destructors of what it made recurse. Up to the
// first mistake, where the parser stops, brackets outside of strings are those of lists and objects.
void ExpectDepth(std::string_view text, const std::string& path, long line) {
  int depth = 0;
  bool in_string = false;
  for (size_t k = 0; k < text.size(); ++k) {
    const char c = text[k];
    if (in_string) {
      if (c == '\\') ++k;
      if (c == '"') in_string = false;
      continue;
    }
    if (c == '"') in_string = true;
    if (c == '[' || c == '{') ++depth;
    if (c == ']' || c == '}') --depth;
    if (depth <= kMostJsonDepth) continue;
    throw FileError(path, LineAt(text, k, line),
                    "JSON nested deeper than " + std::to_string(kMostJsonDepth) + " lists and objects, at byte " +
                        std::to_string(k + 1));
  }
}

}  // namespace

template <class Json>
Json ParseJson(std::string_view text, const std::string& path, long line) {
  ExpectDepth(text, path, line);
  try {
    return Json::parse(text);
  } catch (const typename Json::parse_error& error) {
    const bool is_cut = error.byte > text.size();
    throw FileError(path, LineAt(text, error.byte, line), is_cut ? "the JSON ends too early" : "not valid JSON");
  } catch (const typename Json::exception&) {  // a number beyond the range of double
    throw FileError(path, line > 1 ? line : 0, "holds a number that is too large");
  }
}

template <class Json>
Json ReadJsonObject(const std::string& path, const std::string& what, std::string* text) {
  const auto expect_text = [&](std::string_view start) {
    if (start.find('\0') == std::string_view::npos) return;
    throw FileError(path, 0, "a binary file (it holds a zero byte), expected " + what + " as a JSON object");
  };
  std::string content = ReadAll(path, {MostFileBytes(kMostJsonBytes, 32), expect_text});
  Json object = ParseJson<Json>(content, path);
  if (text != nullptr) *text = std::move(content);
  if (object.is_object()) return object;
  throw FileError(path, 0, "expected " + what + " as a JSON object, found " + object.type_name());
}

void WriteJson(const nlohmann::ordered_json& json, const std::string& path) {
  AtomicFile file(path);
  file.Stream() << json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
  file.Commit();
}

#define TERSE_INSTANTIATE(Json)                                              \
  template Json ParseJson<Json>(std::string_view, const std::string&, long); \
  template Json ReadJsonObject<Json>(const std::string&, const std::string&, std::string*);
TERSE_INSTANTIATE(nlohmann::json)
TERSE_INSTANTIATE(nlohmann::ordered_json)
#undef TERSE_INSTANTIATE

}  // namespace terse
