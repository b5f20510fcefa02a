#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "terse/core/chi_square.h"
#include "terse/core/robust.h"
#include "terse/core/supported_loops.h"
#include "terse/covariance/information_probe.h"
#include "terse/covariance/information_scale.h"

namespace terse {
namespace {

// Between stated and found standard deviations.
constexpr double kLarger = 2, kSmaller = 3, kSmallerConstant = 20;
// Found over stated: no margin any more. And what stays of it.
constexpr double kFarTooCautious = 0.1, kReserve = 3;
constexpr double kDegrees = 180 / 3.14159265358979323846;

struct Band {
  double smaller = 0, larger = 0;  // found over stated: contradicted below and above
};

Band BandOf(const StatedInformation& stated) {
  if (stated.IsPlaceholder()) return {1 / kSmaller, kLarger};
  return {stated.same ? 1 / kSmallerConstant : 0, kLarger};
}

// So many more loops agree than would if standard deviations were that much too small: the others are wrong.
constexpr double kMoreAgree = 0.35;
// The sample over this will do where the verdict does not depend on it.
constexpr int kForReport = 4;
// Without loops that no other bears out, found standard deviations may be smaller for that alone, but not by so much.
constexpr double kMuchSmaller = 3;
// True loops that stand alone, as many do where the information is too certain, are as far from the odometry as others
// are: so many times as far (squared; 0.8 to 1.9 times were seen) are wrong ones.
constexpr double kFarWorse = 5;

bool IsTooCertain(const Band& band, const ScaleEstimate& found) {
  return found.determined && found.sigma_factor > band.larger * std::exp(2 * found.log_error);
}
bool IsTooCautious(const Band& band, const ScaleEstimate& found) {
  return found.determined && found.sigma_factor * std::exp(2 * found.log_error) < band.smaller;
}

// Share of right loops within the stated chi-square's 99th percentile if standard deviations are so many times as
// large.
template <class Pose>
double AgreeingLoops(double sigma_factor) {
  const double most = ChiSquareQuantile(0.99, Pose::kDof) / (sigma_factor * sigma_factor);
  double low = 0, high = 0.99;
  for (int k = 0; k < 30; ++k) {
    const double middle = (low + high) / 2;
    (ChiSquareQuantile(middle, Pose::kDof) < most ? low : high) = middle;
  }
  return low;
}

std::array<const ScaleEstimate*, 4> All(const InformationEstimate& estimate) {
  return {&estimate.odometry.translation, &estimate.odometry.rotation, &estimate.loops.translation,
          &estimate.loops.rotation};
}

KindScale ScaleOf(const KindEstimate& kind) { return {kind.translation.sigma_factor, kind.rotation.sigma_factor}; }
// A few measurements are off by more than most are: a robot's wheels slip, a scan matches one door too far. From loops
// no more is taken than from odometry, or wrong ones could bend that at less cost.
InformationScale WithoutCaution(const InformationEstimate& found) {
  const double translation = std::max(found.odometry.translation.sigma_factor, found.loops.translation.sigma_factor);
  const double rotation = std::max(found.odometry.rotation.sigma_factor, found.loops.rotation.sigma_factor);
  if (std::min(translation, rotation) > kFarTooCautious) return {};
  const KindScale scale = {std::min(1.0, kReserve * translation), std::min(1.0, kReserve * rotation)};
  return {scale, scale};
}

std::string Sigmas(double translation_m, double rotation_rad) {
  char text[64];
  std::snprintf(text, sizeof(text), "%.2g m and %.2g deg", translation_m, rotation_rad * kDegrees);
  return text;
}
std::string Stated(const StatedKind& kind) { return Sigmas(kind.translation_m.median, kind.rotation_rad.median); }
std::string Found(const StatedKind& kind, const KindEstimate& found) {
  return Sigmas(kind.translation_m.median * found.translation.sigma_factor,
                kind.rotation_rad.median * found.rotation.sigma_factor);
}

std::string Times(const InformationEstimate& estimate) {
  char text[160];
  std::snprintf(text, sizeof(text), "odometry %.2g and %.2g, loops %.2g and %.2g times",
                estimate.odometry.translation.sigma_factor, estimate.odometry.rotation.sigma_factor,
                estimate.loops.translation.sigma_factor, estimate.loops.rotation.sigma_factor);
  return text;
}

std::string OthersAreWrong(double agreeing) {
  char text[160];
  std::snprintf(
      text, sizeof(text),
      "the information is left as it is: %.0f %% of the loops agree with the odometry as both are stated, the "
      "others look wrong",
      100 * agreeing);
  return text;
}

std::string What(const StatedInformation& stated) {
  if (stated.IsPlaceholder() && stated.odometry.is_identity) return "the information is the unit matrix";
  if (stated.IsPlaceholder()) return "the information is a constant with implausible standard deviations";
  if (stated.same) return "the information is one constant for all edges";
  return "the information is too certain";
}

double LargestFactor(const InformationEstimate& estimate) {
  double largest = 0;
  for (const ScaleEstimate* group : All(estimate)) {
    if (group->determined) largest = std::max(largest, group->sigma_factor);
  }
  return largest;
}

// By what all loops of the graph say.
template <class Pose>
InformationCalibration CalibrateByAll(const PoseGraph<Pose>& graph, const EstimateOptions& options) {
  InformationCalibration out;
  out.stated = DescribeInformation(graph);
  EstimateOptions sample = options;
  const bool may_be_scaled = out.stated.IsPlaceholder() || BandOf(out.stated).smaller > 0;
  if (!may_be_scaled && internal::ShareOfAgreeingLoops(graph, options) >= internal::kManyAgree) {
    sample.sample_poses /= kForReport;
    sample.sample_loops /= kForReport;
  }
  out.estimate = EstimateInformationScale(graph, sample);
  const InformationEstimate& found = out.estimate;
  if (!found.failure.empty()) {
    out.message = "the residuals cannot tell whether the information is right (" + found.failure + ")";
    return out;
  }
  bool any_determined = false, all_at_floor = true, is_too_certain = false, is_too_cautious = false;
  const Band band = BandOf(out.stated);
  for (const ScaleEstimate* group : All(found)) {
    any_determined = any_determined || group->determined;
    all_at_floor = all_at_floor && (group->at_floor || !group->determined);
    is_too_certain = is_too_certain || IsTooCertain(band, *group);
    is_too_cautious = is_too_cautious || IsTooCautious(band, *group);
  }
  if (!any_determined) {
    out.message = "the residuals cannot tell whether the information is right (too few loops)";
  } else if (all_at_floor) {
    out.message = "the measurements agree to rounding: their residuals cannot tell whether the information is right";
  } else if (is_too_certain &&
             found.agreeing_loops > AgreeingLoops<Pose>(std::max(1.0, LargestFactor(found))) + kMoreAgree) {
    out.verdict = InformationVerdict::kConsistent;
    out.message = OthersAreWrong(found.agreeing_loops);
  } else if (!is_too_certain && !is_too_cautious) {
    out.verdict = InformationVerdict::kConsistent;
    out.without_caution = WithoutCaution(found);
    out.message = "the information is left as it is: residuals are " + Times(found) + " as large as it says";
  } else {
    out.verdict = InformationVerdict::kContradicted;
    out.scale = {ScaleOf(found.odometry), ScaleOf(found.loops)};
    const auto part = [](const char* name, const StatedKind& stated, const KindEstimate& kind) {
      return stated.edges == 0 ? std::string()
                               : name + Found(stated, kind) + " instead of the stated " + Stated(stated);
    };
    out.message = What(out.stated) + " and the residuals contradict it: standard deviations are " +
                  part("", out.stated.odometry, found.odometry) + " (odometry)" +
                  part(", ", out.stated.loops, found.loops) + (out.stated.loops.edges > 0 ? " (loops)" : "");
  }
  return out;
}

}  // namespace

const char* Name(InformationVerdict verdict) {
  switch (verdict) {
    case InformationVerdict::kConsistent: return "consistent";
    case InformationVerdict::kContradicted: return "contradicted";
    case InformationVerdict::kUndetermined: return "undetermined";
  }
  return "?";
}

template <class Pose>
InformationCalibration CalibrateInformation(const PoseGraph<Pose>& graph, const EstimateOptions& options) {
  const internal::LoopSupport support = internal::FindSupport(graph);
  if (support.unsupported.empty() || !support.others_are_many) return CalibrateByAll(graph, options);
  const PoseGraph<Pose> others = WithoutFactors(graph, support.unsupported);
  if (ConnectedComponents(others).size() > 1) return CalibrateByAll(graph, options);
  const auto by_others = [&] {
    InformationCalibration out = CalibrateByAll(others, options);
    out.stated = DescribeInformation(graph);
    out.message += ", without " + std::to_string(support.unsupported.size()) + " loops that no other bears out";
    return out;
  };
  // With many wrong loops every solution costs many times more.
  std::optional<InformationCalibration> without;
  if (support.are_suspect && support.alone_over_others > kFarWorse) {
    without = by_others();
    if (without->verdict == InformationVerdict::kConsistent) return *without;
  }
  InformationCalibration out = CalibrateByAll(graph, options);
  if (out.verdict != InformationVerdict::kContradicted) return out;
  if (!without) without = by_others();
  const bool is_told = without->verdict != InformationVerdict::kUndetermined;
  const bool is_smaller = LargestFactor(out.estimate) >= kMuchSmaller * LargestFactor(without->estimate);
  return is_told && is_smaller ? *without : out;
}

template InformationCalibration CalibrateInformation<SE2>(const PoseGraph<SE2>&, const EstimateOptions&);
template InformationCalibration CalibrateInformation<SE3>(const PoseGraph<SE3>&, const EstimateOptions&);

}  // namespace terse
