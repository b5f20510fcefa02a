#pragma once
// The report of a run as one HTML file that needs nothing else: examples/report, with the runs' data in it.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "terse/compact/run_folder.h"

namespace terse {

// The page's data, see examples/report/README.md. Numbers to seven digits, stats and thresholds as they are.
nlohmann::ordered_json ReportToJson(const std::vector<RunFolder>& runs);

// One run, or two side by side. Written whole or not at all. Throws FileError.
void WriteReport(const std::vector<RunFolder>& runs, const std::string& path);
// The same from the folders that runs have just left behind.
void WriteReport(const std::vector<std::string>& folders, const std::string& path);

}  // namespace terse
