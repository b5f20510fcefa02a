#include "document.h"

#include <fstream>
#include <sstream>

#include "terse/core/atomic_file.h"
#include "terse/core/error.h"

namespace terse {
namespace {

struct Document {
  std::string before, after;  // with the marks
};

Document ReadDocument(const std::string& path, const std::string& mark) {
  std::ifstream in(path);
  std::stringstream buffer;
  buffer << in.rdbuf();
  const std::string text = buffer.str();
  const std::string open = "<!-- " + mark + " -->\n", close = "<!-- /" + mark + " -->";
  const std::size_t begin = text.find(open), end = text.find(close);
  if (!in || begin == std::string::npos || end == std::string::npos || end < begin) {
    throw FileError(path, 0, "cannot be read, or has no place <!-- " + mark + " --> to fill");
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
