#pragma once
// What a loop, true or wrong, would tell the clean map when it arrives.

#include <string>

#include "tables/outlier_scene.h"
#include "terse/compact/thresholds.h"

namespace terse::bench {

std::string GainHeader();
// One row for the true loops and one for the wrong ones. Thresholds: from the clean graph, and from the one with its
// wrong loops.
template <class Pose>
std::string GainRows(const std::string& name, const Contaminated<Pose>& with, const Thresholds<Pose>& clean,
                     const Thresholds<Pose>& contaminated);

}  // namespace terse::bench
