#include "tables/document.h"

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/read_file.h"

namespace terse {
namespace {

struct Document {
  std::string before, after;  // with the marks
};

Document ReadDocument(const std::string& path, const std::string& mark) {
  const std::string text = ReadAll(path);
  const std::string open = "<!-- " + mark + " -->\n", close = "<!-- /" + mark + " -->";
  const std::size_t begin = text.find(open), end = text.find(close);
  if (begin == std::string::npos || end == std::string::npos || end < begin) {
    throw FileError(path, 0, "has no place <!-- " + mark + " --> to fill");
  }
  return {text.substr(0, begin + open.size()), text.substr(end)};
}

}  // namespace

void RequirePlace(const std::string& path, const std::string& mark) { ReadDocument(path, mark); }

void UpdateDocument(const std::string& path, const std::string& text, const std::string& mark) {
  const Document document = ReadDocument(path, mark);
  AtomicFile file(path);
  file.Stream() << document.before << '\n' << text << '\n' << document.after;
  file.Commit();
}

}  // namespace terse
