#include "calibration.h"

#include "terse/core/atomic_file.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

ordered_json ToJson(const SigmaSpread& spread) { return {spread.low, spread.median, spread.high}; }
ordered_json ToJson(const KindScale& scale) {
  return {{"translation", scale.translation}, {"rotation", scale.rotation}};
}
ordered_json ToJson(const ScaleEstimate& found) {
  return {{"sigma_factor", found.sigma_factor},
          {"log_error", found.log_error},
          {"redundancy", found.redundancy},
          {"determined", found.determined},
          {"at_floor", found.at_floor}};
}
ordered_json ToJson(const StatedKind& stated) {
  return {{"edges", stated.edges},
          {"sigma_translation_m", ToJson(stated.translation_m)},
          {"sigma_rotation_rad", ToJson(stated.rotation_rad)},
          {"constant", stated.is_constant},
          {"identity", stated.is_identity}};
}
ordered_json ToJson(const StatedKind& stated, const KindEstimate& found) {
  ordered_json json = ToJson(stated);
  json["translation"] = ToJson(found.translation);
  json["rotation"] = ToJson(found.rotation);
  return json;
}

}  // namespace

nlohmann::ordered_json ToJson(const InformationScale& scale) {
  return {{"odometry", ToJson(scale.odometry)}, {"loops", ToJson(scale.loops)}};
}

nlohmann::ordered_json ToJson(const InformationCalibration& calibration) {
  const InformationEstimate& found = calibration.estimate;
  ordered_json json;
  json["verdict"] = Name(calibration.verdict);
  json["message"] = calibration.message;
  json["sigma_scale"] = ToJson(calibration.scale);
  json["placeholder"] = calibration.stated.IsPlaceholder();
  json["same_for_odometry_and_loops"] = calibration.stated.same;
  json["odometry"] = ToJson(calibration.stated.odometry, found.odometry);
  json["loops"] = ToJson(calibration.stated.loops, found.loops);
  json["sample"] = {{"poses", found.poses},           {"edges", found.edges},
                    {"loop_edges", found.loop_edges}, {"loops_left_out", found.loops_left_out},
                    {"iterations", found.iterations}, {"normalized_chi2", found.normalized_chi2}};
  return json;
}

std::string InformationComment(const InformationScale& scale) {
  if (scale.IsOne()) return "";
  const auto kind = [](const KindScale& s) {
    return Shortest(s.translation) + " (translation) and " + Shortest(s.rotation) + " (rotation)";
  };
  return "information calibrated by terse: the input's standard deviations times " + kind(scale.odometry) +
         " of odometry, " + kind(scale.loops) + " of loops";
}

}  // namespace terse
