#include "run/calibration.h"

#include "terse/compact/compact_json.h"

namespace terse {
namespace {

using nlohmann::ordered_json;

ordered_json ToJson(const SigmaSpread& spread) { return {spread.low, spread.median, spread.high}; }
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

std::string SigmasInWords(const StatedKind& stated) {
  if (stated.edges == 0) return "none";
  constexpr double kDegrees = 180 / 3.14159265358979323846;
  const SigmaSpread &t = stated.translation_m, &r = stated.rotation_rad;
  char text[160];
  std::snprintf(text, sizeof(text), "%.3g m (%.3g to %.3g), %.3g deg (%.3g to %.3g)", t.median, t.low, t.high,
                r.median * kDegrees, r.low * kDegrees, r.high * kDegrees);
  return text;
}

std::string InformationInWords(const InformationCalibration& calibration) {
  const StatedInformation& stated = calibration.stated;
  if (stated.odometry.edges + stated.loops.edges == 0) return "there are no edges";
  const bool is_identity = (stated.odometry.edges == 0 || stated.odometry.is_identity) &&
                           (stated.loops.edges == 0 || stated.loops.is_identity);
  std::string text = "differs from edge to edge";
  if (is_identity) {
    text = "the unit matrix on all edges, which nobody estimated";
  } else if (stated.same) {
    text = "the same on all edges, odometry and loops, which looks invented";
  } else if (stated.odometry.is_constant && stated.loops.is_constant) {
    text = "one constant for odometry and one for loops";
  } else if (stated.odometry.is_constant || stated.loops.is_constant) {
    text = stated.odometry.is_constant ? "the same on all odometry edges" : "the same on all loops";
  }
  if (!is_identity && stated.IsPlaceholder()) text += ", with implausible standard deviations";
  return text + "; " + calibration.message;
}

}  // namespace terse
