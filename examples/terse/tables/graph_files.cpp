#include "tables/graph_files.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <filesystem>
#include <fstream>
#include <map>

#include "terse/core/error.h"

namespace terse {
namespace {

namespace fs = std::filesystem;

// Trajectories are .txt files too, and begin with a number.
bool BeginsWithWord(const fs::path& path) {
  std::ifstream file(path);
  char first = 0;
  file >> first;
  return std::isalpha(static_cast<unsigned char>(first)) != 0;
}

bool IsGraph(const fs::path& path) {
  static const std::array<const char*, 4> endings = {".g2o", ".graph", ".toro", ".isam"};
  const std::string ending = path.extension().string();
  return std::find(endings.begin(), endings.end(), ending) != endings.end() ||
         (ending == ".txt" && BeginsWithWord(path));
}

}  // namespace

std::vector<GraphPath> FindGraphFiles(const std::string& folder) {
  std::error_code error;
  std::vector<GraphPath> found;
  std::map<std::string, int> count;
  fs::recursive_directory_iterator it(folder, error);
  if (error) throw FileError(folder, 0, error.message());
  for (const fs::recursive_directory_iterator end; !error && it != end; it.increment(error)) {
    if (!it->is_regular_file(error) || !IsGraph(it->path())) continue;
    found.push_back({it->path().stem().string(), it->path().string()});
    ++count[found.back().name];
  }
  if (error) throw FileError(folder, 0, error.message());
  if (found.empty()) throw FileError(folder, 0, "no graph in it, nor below (.g2o, .graph, .toro, .isam, .txt)");
  for (GraphPath& graph : found) {
    if (count[graph.name] > 1) graph.name = fs::path(graph.path).lexically_relative(folder).generic_string();
  }
  std::sort(found.begin(), found.end(), [](const GraphPath& a, const GraphPath& b) { return a.path < b.path; });
  return found;
}

}  // namespace terse
