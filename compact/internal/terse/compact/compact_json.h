#pragma once
// What the files of a run and what the command prints have in common, as JSON: docs/outputs.md.

#include <nlohmann/json.hpp>

#include "terse/compact/compact_options.h"
#include "terse/covariance/information_scale.h"

namespace terse {

nlohmann::ordered_json ToJson(const InformationScale& scale);

// As in thresholds.json.
template <class Pose>
nlohmann::ordered_json ThresholdsToJson(const Thresholds<Pose>& thresholds);

}  // namespace terse
