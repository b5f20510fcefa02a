#include "terse/compact/compact_json.h"

namespace terse {
namespace {

nlohmann::ordered_json ToJson(const KindScale& scale) {
  return {{"translation", scale.translation}, {"rotation", scale.rotation}};
}

}  // namespace

nlohmann::ordered_json ToJson(const InformationScale& scale) {
  return {{"odometry", ToJson(scale.odometry)}, {"loops", ToJson(scale.loops)}};
}

template <class Pose>
nlohmann::ordered_json ThresholdsToJson(const Thresholds<Pose>& thresholds) {
  nlohmann::ordered_json rows = nlohmann::ordered_json::array();
  for (int i = 0; i < Pose::kDof; ++i) {
    const Vector<Pose::kDof> row = thresholds.link_covariance.row(i).transpose();
    rows.push_back(std::vector<double>(row.data(), row.data() + row.size()));
  }
  return {{"dimension", Pose::kDim},
          {"range", std::vector<double>(thresholds.range.data(), thresholds.range.data() + thresholds.range.size())},
          {"probability", thresholds.probability},
          {"min_loop_gain", thresholds.min_loop_gain},
          {"min_pose_gain", thresholds.min_pose_gain},
          {"link_covariance", rows}};
}

template nlohmann::ordered_json ThresholdsToJson<SE2>(const Thresholds<SE2>&);
template nlohmann::ordered_json ThresholdsToJson<SE3>(const Thresholds<SE3>&);

}  // namespace terse
