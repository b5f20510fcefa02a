#include "tables/document.h"

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/read_file.h"

namespace terse {
namespace {

struct Document {
  std::string before, between, after;  // with the marks
};

Document ReadDocument(const std::string& path, const std::string& mark) {
  const std::string text = ReadAll(path);
  const std::string open = "<!-- " + mark + " -->\n", close = "<!-- /" + mark + " -->";
  const std::size_t begin = text.find(open), end = text.find(close);
  if (begin == std::string::npos || end == std::string::npos || end < begin) {
    throw FileError(path, 0, "has no place <!-- " + mark + " --> to fill");
  }
  const std::size_t inside = begin + open.size();
  return {text.substr(0, inside), text.substr(inside, end - inside), text.substr(end)};
}

void Write(const std::string& path, const std::string& text) {
  AtomicFile file(path);
  file.Stream() << text;
  file.Commit();
}

}  // namespace

void RequirePlace(const std::string& path, const std::string& mark) { ReadDocument(path, mark); }

void UpdateDocument(const std::string& path, const std::string& text, const std::string& mark) {
  const Document document = ReadDocument(path, mark);
  Write(path, document.before + '\n' + text + '\n' + document.after);
}

void AppendToDocument(const std::string& path, const std::string& lines, const std::string& mark) {
  const Document document = ReadDocument(path, mark);
  Write(path, document.before + document.between + lines + document.after);
}

}  // namespace terse
