#pragma once
// Charts of runs over their steps as SVG. Several runs share the panels.

#include <string>
#include <vector>

#include "terse/compact/run_folder.h"

namespace terse {

// Gains of loops and poses against their thresholds.
std::string DrawGains(const std::vector<RunFolder>& runs);
// Seconds of the steps, the size of map and factor, and the gate.
std::string DrawTimings(const std::vector<RunFolder>& runs);

}  // namespace terse
