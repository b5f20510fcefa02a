#pragma once
// --keep-poses, --keep-links, --poses-per-area and --error: how much of a run the map may keep; --min-variance-drop:
// what a link must tell besides nats.

#include <CLI/CLI.hpp>

#include "terse/compact/compact_options.h"

namespace terse {

void AddBudgetOptions(CLI::App& command, CompactBudget& budget);
void AddVarianceOption(CLI::App& command, double& min_variance_drop);

}  // namespace terse
