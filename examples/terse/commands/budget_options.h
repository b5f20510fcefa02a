#pragma once
// --keep-poses, --keep-links, --poses-per-area and --error: how much of a run the map may keep; --min-variance-drop and
// --retire-share: what a link must tell besides nats, and what a pose that retires may lose.

#include <CLI/CLI.hpp>

#include "terse/compact/compact_options.h"

namespace terse {

void AddBudgetOptions(CLI::App& command, CompactBudget& budget);
void AddBoundedOptions(CLI::App& command, double& min_variance_drop, double& retire_share);

}  // namespace terse
