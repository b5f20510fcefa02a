#pragma once
// The table of methods against wrong loops for the eye and as JSON (docs/outputs.md).

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tables/outlier_table.h"

namespace terse {

// In Markdown. A line about the graph and its table; the summaries over all graphs; all of it.
std::string OutlierGraphText(const OutlierGraph& graph);
std::string OutlierSummaryText(const std::vector<OutlierGraph>& graphs);
std::string OutlierTableText(const std::vector<OutlierGraph>& graphs);

nlohmann::ordered_json OutlierRunJson(const OutlierRun& run);
nlohmann::ordered_json OutlierTableJson(const std::vector<OutlierGraph>& graphs, const OutlierTableOptions& options);

}  // namespace terse
