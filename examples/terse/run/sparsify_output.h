#pragma once
// What `terse sparsify` leaves behind: docs/outputs.md.

#include <nlohmann/json.hpp>
#include <string>

#include "terse/compact/sparsify.h"
#include "terse/core/rotation_information.h"

namespace terse {

// stats.json but for times of the command's own.
template <class Pose>
nlohmann::ordered_json SparsifyStats(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small,
                                     const SparsifyOptions& options);

// compact.g2o, graph.json, trajectory.tum and links.csv. The folder is there. Files are written whole or not at all.
template <class Pose>
void WriteSparsified(const PoseGraph<Pose>& graph, const Sparsified<Pose>& small, RotationInformation rotation,
                     const std::string& folder);

// The files of the folder, stats.json last.
const std::vector<std::string>& SparsifyFiles();

}  // namespace terse
