#include "terse/compact/thresholds.h"

#include <algorithm>
#include <cmath>

#include "terse/compact/information.h"

namespace terse {
namespace {

constexpr double kPi = 3.14159265358979323846;

double Percentile90(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto nth = values.begin() + static_cast<long>(0.9 * static_cast<double>(values.size() - 1) + 0.5);
  std::nth_element(values.begin(), nth, values.end());
  return *nth;
}

// Per dimension the least range with which the displacement passes, by bisection.
template <class Pose>
Vector<Displacement<Pose>::kSize> LeastRange(const Displacement<Pose>& displacement, double probability) {
  using Range = Vector<Displacement<Pose>::kSize>;
  Range low = Range::Constant(1e-6);
  Range high = displacement.mean.cwiseAbs() + 40 * displacement.covariance.diagonal().cwiseMax(0).cwiseSqrt();
  high = high.cwiseMax(1e-3);
  high[Pose::kDim] = kPi;
  for (int k = 0; k < 50; ++k) {
    const Range middle = (low + high) / 2;
    const Range passed = RangeProbabilities<Pose>(displacement, middle);
    for (int i = 0; i < passed.size(); ++i) (passed[i] > probability ? high : low)[i] = middle[i];
  }
  return high;
}

}  // namespace

template <class Pose>
Thresholds<Pose> SelectThresholds(const PoseGraph<Pose>& graph, const SampleOptions& options) {
  GraphReplay<Pose> replay(graph);
  CompactOptions<Pose> everything;
  everything.strategy = Strategy::kApal;
  everything.link_covariance = replay.LinkCovariance();
  CompactPoseSlam<Pose> slam(everything);
  Thresholds<Pose> out;
  out.probability = options.probability;
  out.range.setZero();
  std::vector<double> loop_gains, pose_gains;
  const auto& inputs = replay.Inputs();
  const long sample = std::lround(options.share * static_cast<double>(inputs.size()));
  for (long k = 0; k < sample; ++k) {
    const CompactInput<Pose>& input = inputs[static_cast<std::size_t>(k)];
    if (k > 0) {
      const std::vector<PoseId>& loops = *input.linkable;
      std::vector<PoseId> from(loops);
      from.push_back(input.odometry->from == input.id ? input.odometry->to : input.odometry->from);
      std::vector<double> gains;
      for (const auto& T_pose_new : slam.Predict(input, from)) {
        gains.push_back(InformationGain<Pose::kDof>(T_pose_new.covariance, everything.link_covariance));
        if (gains.size() > loops.size()) break;  // the odometry, always in range
        loop_gains.push_back(gains.back());
        const auto displacement = ComputeDisplacement<Pose>(T_pose_new, everything.view_axis);
        out.range = out.range.cwiseMax(LeastRange<Pose>(displacement, options.probability));
      }
      pose_gains.push_back(*std::min_element(gains.begin(), gains.end()));
    }
    slam.AddPose(input, replay.AsRegistration());
    if (options.progress) options.progress(k + 1, sample);
  }
  out.range = out.range.cwiseMax(replay.LinkRange());
  out.min_loop_gain = Percentile90(loop_gains);
  out.min_pose_gain = std::exp(1.7 * std::log(Percentile90(pose_gains) + 1)) - 1;
  return out;
}

template Thresholds<SE2> SelectThresholds<SE2>(const PoseGraph<SE2>&, const SampleOptions&);
template Thresholds<SE3> SelectThresholds<SE3>(const PoseGraph<SE3>&, const SampleOptions&);

}  // namespace terse
