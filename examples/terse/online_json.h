#pragma once
// What `online` answers, as JSON objects of one line each: docs/outputs.md.

#include <nlohmann/json.hpp>
#include <string>

#include "terse/compact/measurement_stream.h"

namespace terse {

template <class Pose>
nlohmann::ordered_json ToJson(const StreamOutcome& outcome, const CompactPoseSlam<Pose>& slam);

// Text that is no UTF-8 becomes replacement characters.
std::string OneLine(const nlohmann::ordered_json& json);

}  // namespace terse
