#pragma once
// The report of `terse merge` as one HTML file that needs nothing else: the maps, each alone and all as one, and what
// became of the links.

#include <nlohmann/json.hpp>
#include <string>

#include "terse/compact/merge.h"

namespace terse {

// `stats`: stats.json. Written whole or not at all. Throws FileError.
template <class Pose>
void WriteMergeReport(const std::vector<MapToMerge<Pose>>& maps, const Merged<Pose>& merged,
                      const nlohmann::ordered_json& stats, const std::string& path);

}  // namespace terse
