#pragma once
// Maps of runs from above as SVG: estimate, kept poses, loops coloured by gain, ellipses, ground truth.

#include <string>
#include <vector>

#include "terse/compact/run_folder.h"

namespace terse {

// Side by side at one scale, in the plane of the two largest extents of the first run. Legible on white and on black.
// Ellipses hold a position with 95 %; of some kept poses, evenly spread. `gain_unit`: of the loops.
std::string DrawMaps(const std::vector<RunFolder>& runs, const std::string& gain_unit = "nats");

}  // namespace terse
