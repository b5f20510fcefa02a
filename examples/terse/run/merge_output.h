#pragma once
// What `terse merge` leaves behind: docs/outputs.md.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "terse/compact/merge.h"
#include "terse/core/rotation_information.h"
#include "terse/covariance/information_scale.h"

namespace terse {

// stats.json but for times.
template <class Pose>
nlohmann::ordered_json MergeStats(const Merged<Pose>& merged);

// compact.g2o, graph.json, thresholds.json, trajectory.tum and links.csv. The folder is there. Files are written whole
// or not at all. `scale`: by which the measurements of the maps differ from what was measured.
template <class Pose>
void WriteMerged(const Merged<Pose>& merged, RotationInformation rotation, const InformationScale& scale,
                 const std::string& folder);

// The files of the folder, stats.json last.
const std::vector<std::string>& MergeFiles();

}  // namespace terse
