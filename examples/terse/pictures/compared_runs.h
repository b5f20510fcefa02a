#pragma once
// The runs that a picture or a report is of.

#include <string>
#include <vector>

#include "terse/compact/run_folder.h"

namespace terse {

// One or two, to compare: their names differ. Throws as ReadRunFolder.
std::vector<RunFolder> ReadRunFolders(const std::vector<std::string>& paths);

}  // namespace terse
