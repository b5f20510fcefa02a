#pragma once
// Packed graphs, as read: see WritePacked (terse/core/graph_file.h).

#include <string>

#include "terse/core/graph_file.h"

namespace terse {

// Whether a file begins as one. False for what can be read only once, as a pipe.
bool LooksPacked(const std::string& path);
// Throws FileError.
GraphFile ReadPacked(const std::string& path, const ReadOptions& options);

}  // namespace terse
