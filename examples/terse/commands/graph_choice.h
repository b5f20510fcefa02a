#pragma once
// --graphs: which of a folder's graphs a table is about.

#include <string>
#include <vector>

#include "tables/graph_files.h"

namespace terse {

// Those of these names, all without any; of several of one name by the file's alone all. Throws CLI::ValidationError
// for --graphs if there is no such graph.
std::vector<GraphPath> ChooseGraphFiles(const std::string& folder, const std::vector<std::string>& names);

}  // namespace terse
