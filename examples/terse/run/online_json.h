#pragma once
// What `online` answers, as JSON objects of one line each: docs/outputs.md.

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "terse/compact/measurement_stream.h"

namespace terse {

template <class Pose>
nlohmann::ordered_json ToJson(const StreamOutcome& outcome, const CompactPoseSlam<Pose>& slam);

// Of a map that was made again: why, and what is in it.
template <class Pose>
nlohmann::ordered_json ToJson(const Review& review, const CompactPoseSlam<Pose>& slam);

// The covariance of one pose, or of the second seen from the first. Throws NumericalError if it is not finite.
template <class Pose>
nlohmann::ordered_json CovarianceJson(const std::vector<PoseId>& poses, const CompactPoseSlam<Pose>& slam,
                                      const CovarianceConvention& convention);
// Row by row; null if it is not finite.
nlohmann::ordered_json RowsJson(const MatrixX& covariance);

// Text that is no UTF-8 becomes replacement characters.
std::string OneLine(const nlohmann::ordered_json& json);

}  // namespace terse
