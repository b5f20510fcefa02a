#include "commands/pose_ids.h"

#include <CLI/Error.hpp>
#include <algorithm>
#include <charconv>

namespace terse {

PoseId ParseId(const std::string& text, const std::string& option) {
  PoseId id;
  const char* end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, id.value);
  if (error != std::errc() || stop != end) {
    throw CLI::ValidationError(option, "'" + text + "' is not the id of a pose, which is a whole number");
  }
  return id;
}

std::vector<PoseId> ParseIds(const std::string& text, const std::string& option) {
  std::vector<PoseId> ids;
  for (std::size_t start = 0; start <= text.size();) {
    const std::size_t comma = std::min(text.find(',', start), text.size());
    ids.push_back(ParseId(text.substr(start, comma - start), option));
    start = comma + 1;
  }
  return ids;
}

}  // namespace terse
