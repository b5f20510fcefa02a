#include "terse/compact/thresholds.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include "sample.h"

namespace terse {
namespace {

// Per degree of freedom; thresholds.h says why.
constexpr double kLeastLoopGain = 0.5, kMostLoopGain = 1.5, kLeastPoseGain = 0.9, kBoundedLoopGain = 0.425;
constexpr double kRareLoopGain = 0.02, kManyLoops = 0.5, kRareness = 1.5;
constexpr double kPoseToLoop = 0.9;

// Of the links of the sample's map. With more, those that are refused do not tell of the sensor's range.
constexpr double kMostRefused = 0.02;
// Of a longer run the beginning stands for the whole: the sample's map holds all poses up to the last looked at.
constexpr long kMostMapPoses = 5000;

double Raise(double gain, double power) { return std::exp(power * std::log(gain + 1)) - 1; }

double Percentile90(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto nth = values.begin() + std::lround(0.9 * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

}  // namespace

std::vector<long> SamplePositions(long poses, long count) {
  std::mt19937_64 engine(1);
  std::vector<long> out;
  for (long k = 0; k < count; ++k) {
    const long first = k * poses / count, end = (k + 1) * poses / count;
    out.push_back(first + static_cast<long>(engine() % static_cast<std::uint64_t>(end - first)));
  }
  return out;
}

template <class Pose>
SampledThresholds<Pose> SelectThresholds(const PoseGraph<Pose>& graph, const SampleOptions& options) {
  if (!(options.share > 0 && options.share <= 1) || !(options.probability >= 0 && options.probability < 1)) {
    throw std::invalid_argument("sample options: the share must be in (0, 1], the probability in [0, 1)");
  }
  if (options.most_poses < 1) throw std::invalid_argument("sample options: at least one pose is needed");
  GraphReplay<Pose> replay(graph);
  Sample<Pose> sample(options, replay);
  const auto& inputs = replay.Inputs();
  const auto poses = static_cast<long>(inputs.size());
  const long within = std::min(poses, kMostMapPoses);
  SampledThresholds<Pose> out;
  out.thresholds.probability = options.probability;
  out.thresholds.link_covariance = replay.LinkCovariance();
  out.sample_poses = std::min(options.most_poses, std::lround(options.share * static_cast<double>(poses)));
  out.sample_poses = std::min(out.sample_poses, within);
  const std::vector<long> looked_at = SamplePositions(within, out.sample_poses);
  const long end = looked_at.empty() ? 0 : looked_at.back() + 1;
  for (long k = 0; k < end; ++k) {
    sample.Add(inputs[static_cast<std::size_t>(k)], std::binary_search(looked_at.begin(), looked_at.end(), k));
    if (options.progress) options.progress(k + 1, end);
  }
  out.sample_loops = sample.loops_seen;
  out.sample_links = sample.links;
  const bool some_are_wrong =
      static_cast<double>(sample.refused) > kMostRefused * static_cast<double>(sample.refused + sample.links);
  out.thresholds.range =
      some_are_wrong ? replay.LinkRange(sample.believed, options.distance) : replay.LinkRange(options.distance);
  out.loop_gain_90 = Percentile90(sample.loop_gains);
  out.pose_gain_90 = Percentile90(sample.pose_gains);
  const double loops = static_cast<double>(replay.LinksOffered()) / static_cast<double>(std::max(poses, 1L));
  const double most =
      kRareLoopGain + (kMostLoopGain - kRareLoopGain) * std::pow(std::min(1.0, loops / kManyLoops), kRareness);
  const double usual =
      std::clamp(Raise(out.loop_gain_90, 1.36), kLeastLoopGain * Pose::kDof, kMostLoopGain * Pose::kDof);
  const bool is_bounded = options.strategy == Strategy::kBounded;
  out.thresholds.min_loop_gain = std::min(is_bounded ? kBoundedLoopGain * Pose::kDof : usual, most * Pose::kDof);
  out.thresholds.min_pose_gain =
      std::max({Raise(out.pose_gain_90, 1.7), kLeastPoseGain * Pose::kDof, kPoseToLoop * usual});
  return out;
}

template SampledThresholds<SE2> SelectThresholds<SE2>(const PoseGraph<SE2>&, const SampleOptions&);
template SampledThresholds<SE3> SelectThresholds<SE3>(const PoseGraph<SE3>&, const SampleOptions&);

}  // namespace terse
