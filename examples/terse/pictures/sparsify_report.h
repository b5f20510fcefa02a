#pragma once
// The report of `terse sparsify` as one HTML file that needs nothing else: numbers, the map before and after, links by
// worth, error against size.

#include <nlohmann/json.hpp>
#include <string>

#include "terse/compact/sparsify.h"

namespace terse {

// `stats`: stats.json. Written whole or not at all. Throws FileError.
template <class Pose>
void WriteSparsifyReport(const std::string& name, const PoseGraph<Pose>& graph, const Sparsified<Pose>& small,
                         const nlohmann::ordered_json& stats, const std::string& path);

}  // namespace terse
