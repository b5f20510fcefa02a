#pragma once
// Information that is no covariance (information_scale.h), as commands report it.

#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "terse/covariance/information_scale.h"

namespace terse {

// `information` of stats.json: docs/outputs.md.
nlohmann::ordered_json ToJson(const InformationCalibration& calibration);

// What the information looks like and whether the residuals agree with it, for people.
std::string InformationInWords(const InformationCalibration& calibration);
// "0.1 m (0.08 to 0.2), 1.2 deg (1 to 1.3)": median, 10th and 90th percentile.
std::string SigmasInWords(const StatedKind& stated);

}  // namespace terse
