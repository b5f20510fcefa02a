#include "terse/compact/json_file.h"

#include <algorithm>
#include <cstddef>
#include <vector>

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

// `parse` of the text, what is wrong with it as a FileError.
template <class Json, class Parse>
Json Parsed(std::string_view text, const std::string& path, long line, const Parse& parse) {
  ExpectDepth(text, path, line);
  try {
    return parse(text);
  } catch (const typename Json::parse_error& error) {
    const bool is_cut = error.byte > text.size();
    throw FileError(path, LineAt(text, error.byte, line), is_cut ? "the JSON ends too early" : "not valid JSON");
  } catch (const typename Json::exception&) {  // a number beyond the range of double
    throw FileError(path, line > 1 ? line : 0, "holds a number that is too large");
  }
}

std::string ReadJsonText(const std::string& path, const std::string& what) {
  const auto expect_text = [&](std::string_view start) {
    if (start.find('\0') == std::string_view::npos) return;
    throw FileError(path, 0, "a binary file (it holds a zero byte), expected " + what + " as a JSON object");
  };
  return ReadAll(path, {MostFileBytes(kMostJsonBytes, 32), expect_text});
}

template <class Json>
Json ExpectObject(Json value, const std::string& path, const std::string& what) {
  if (value.is_object()) return value;
  throw FileError(path, 0, "expected " + what + " as a JSON object, found " + value.type_name());
}

// Builds what stands behind some keys, and passes over the rest. (nlohmann's parser with a callback does it too, but
// looks through the whole of a list at the end of each of its objects.)
class PartBuilder : public nlohmann::json_sax<nlohmann::json> {
 public:
  using Json = nlohmann::json;
  explicit PartBuilder(const std::set<std::string>& keys) : keys_(keys) {}
  Json Take() { return std::move(root_); }

  bool null() override { return Add(nullptr); }
  bool boolean(bool value) override { return Add(value); }
  bool number_integer(number_integer_t value) override { return Add(value); }
  bool number_unsigned(number_unsigned_t value) override { return Add(value); }
  bool number_float(number_float_t value, const string_t& text) override {
    static_cast<void>(text);
    return Add(value);
  }
  bool string(string_t& value) override { return Add(std::move(value)); }
  bool binary(binary_t& value) override { return Add(std::move(value)); }
  bool start_object(std::size_t size) override {
    static_cast<void>(size);
    return Open(Json::object());
  }
  bool start_array(std::size_t size) override {
    static_cast<void>(size);
    return Open(Json::array());
  }
  bool end_object() override { return Close(); }
  bool end_array() override { return Close(); }
  bool key(string_t& name) override {
    if (passed_over_ > 0) return true;
    is_wanted_ = keys_.count(name) != 0;
    if (is_wanted_) key_ = std::move(name);
    return true;
  }
  bool parse_error(std::size_t position, const std::string& token, const Json::exception& error) override {
    static_cast<void>(position);
    static_cast<void>(token);
    if (const auto* range = dynamic_cast<const Json::out_of_range*>(&error)) throw Json::out_of_range(*range);
    throw Json::parse_error(dynamic_cast<const Json::parse_error&>(error));
  }

 private:
  bool IsWanted() const { return passed_over_ == 0 && (open_.empty() || open_.back()->is_array() || is_wanted_); }
  template <class Value>
  Json& Place(Value&& value) {
    if (open_.empty()) return root_ = std::forward<Value>(value);
    if (open_.back()->is_object()) return (*open_.back())[key_] = std::forward<Value>(value);
    open_.back()->push_back(std::forward<Value>(value));
    return open_.back()->back();
  }
  template <class Value>
  bool Add(Value&& value) {
    if (IsWanted()) Place(Json(std::forward<Value>(value)));
    return true;
  }
  bool Open(Json empty) {
    if (!IsWanted()) {
      ++passed_over_;
    } else {
      open_.push_back(&Place(std::move(empty)));
    }
    return true;
  }
  bool Close() {
    if (passed_over_ > 0) {
      --passed_over_;
    } else {
      open_.pop_back();
    }
    return true;
  }

  const std::set<std::string>& keys_;
  Json root_;
  std::vector<Json*> open_;  // lists and objects that have not ended; none moves while those within are built
  std::string key_;
  bool is_wanted_ = true;  // the value that comes, within an object
  int passed_over_ = 0;    // lists and objects that have not ended and are not built
};

}  // namespace

template <class Json>
Json ParseJson(std::string_view text, const std::string& path, long line) {
  return Parsed<Json>(text, path, line, [](std::string_view all) { return Json::parse(all); });
}

template <class Json>
Json ReadJsonObject(const std::string& path, const std::string& what, std::string* text) {
  std::string content = ReadJsonText(path, what);
  Json object = ParseJson<Json>(content, path);
  if (text != nullptr) *text = std::move(content);
  return ExpectObject(std::move(object), path, what);
}

nlohmann::json ReadJsonObject(const std::string& path, const std::string& what, const std::set<std::string>& keys) {
  using Json = nlohmann::json;
  const auto parse = [&](std::string_view text) {
    PartBuilder builder(keys);
    Json::sax_parse(text, &builder);
    return builder.Take();
  };
  return ExpectObject(Parsed<Json>(ReadJsonText(path, what), path, 1, parse), path, what);
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
