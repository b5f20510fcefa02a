#pragma once
// --keep-poses, --keep-links, --poses-per-area and --error: how much of a run the map may keep; --min-variance-drop and
// --retire-share: what a link must tell besides nats, and what a pose that retires may lose; --remember: what is held
// of poses that the map dropped.

#include <CLI/CLI.hpp>
#include <optional>
#include <string>

#include "terse/compact/compact_options.h"

namespace terse {

void AddBudgetOptions(CLI::App& command, CompactBudget& budget);
void AddBoundedOptions(CLI::App& command, double& min_variance_drop, double& retire_share);

inline constexpr const char* kRememberAll = "all";
// `remember`: a number of poses, or kRememberAll.
CLI::Option& AddRememberOption(CLI::App& command, std::string& remember, const std::string& help);
// CompactOptions::most_dropped.
std::optional<int> MostDropped(const std::string& remember);

}  // namespace terse
