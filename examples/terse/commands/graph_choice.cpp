#include "commands/graph_choice.h"

#include <algorithm>
#include <filesystem>

#include "commands/commands.h"

namespace terse {

std::vector<GraphPath> ChooseGraphFiles(const std::string& folder, const std::vector<std::string>& names) {
  std::vector<GraphPath> found = FindGraphFiles(folder);
  if (names.empty()) return found;
  const auto is = [](const GraphPath& graph, const std::string& name) {
    return graph.name == name || std::filesystem::path(graph.path).stem() == name;
  };
  std::vector<std::string> known;
  for (const GraphPath& graph : found) known.push_back(graph.name);
  for (const std::string& name : names) {
    if (std::any_of(found.begin(), found.end(), [&](const GraphPath& graph) { return is(graph, name); })) continue;
    const std::string nearest = NearestName(name, known);
    throw CLI::ValidationError(
        "--graphs", "no graph " + name + " in " + folder + (nearest.empty() ? "" : "; did you mean " + nearest + "?"));
  }
  const auto is_left_out = [&](const GraphPath& graph) {
    return std::none_of(names.begin(), names.end(), [&](const std::string& name) { return is(graph, name); });
  };
  found.erase(std::remove_if(found.begin(), found.end(), is_left_out), found.end());
  return found;
}

}  // namespace terse
