#pragma once
// The tables of compact pose SLAM for the eye and as JSON (docs/outputs.md).

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tables/compact_table.h"

namespace terse {

// All four, each under its title, in Markdown.
std::string CompactTablesText(const std::vector<CompactTableRow>& rows);
nlohmann::ordered_json ToJson(const CompactTableRow& row);

}  // namespace terse
