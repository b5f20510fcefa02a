#pragma once
// Information that is no covariance (information_scale.h), as commands report it.

#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "terse/covariance/information_scale.h"

namespace terse {

// `information` of stats.json: docs/outputs.md.
nlohmann::ordered_json ToJson(const InformationScale& scale);
nlohmann::ordered_json ToJson(const InformationCalibration& calibration);

// Which information a written graph carries, for the first line of its file; "" if it is the input's.
std::string InformationComment(const InformationScale& scale);

}  // namespace terse
