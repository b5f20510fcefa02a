#pragma once
// --keep-poses, --keep-links, --poses-per-area and --error: how much of a run the map may keep.

#include <CLI/CLI.hpp>

#include "terse/compact/compact_options.h"

namespace terse {

void AddBudgetOptions(CLI::App& command, CompactBudget& budget);

}  // namespace terse
