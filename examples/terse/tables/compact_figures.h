#pragma once
// Figures 6, 8 and 9 of Ila et al. 2017 as CSV and SVG (docs/outputs.md).

#include <string>
#include <vector>

#include "tables/compact_table.h"

namespace terse {

// As CSV and SVG each: GRAPH_norms (Fig. 6), if the row has norms; GRAPH_laps (Fig. 8), if there are `laps`;
// GRAPH_growth (Fig. 9). Into the folder, which must exist. Returns the names of the files.
std::vector<std::string> WriteFigures(const CompactTableRow& row, int laps, const std::string& folder);

}  // namespace terse
