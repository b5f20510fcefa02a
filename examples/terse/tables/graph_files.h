#pragma once
// The graph files of a folder.

#include <string>
#include <vector>

namespace terse {

struct GraphPath {
  std::string name;  // the file's name without its ending; of several of that name the path below the folder
  std::string path;
};

// All .g2o, .graph, .toro and .isam files in the folder and below, and those .txt files that begin like a graph: with a
// word. Sorted by path. Throws FileError if the folder cannot be read or holds none.
std::vector<GraphPath> FindGraphFiles(const std::string& folder);

}  // namespace terse
