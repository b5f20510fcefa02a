#include "compact_run.h"

#include <limits>
#include <numeric>

#include "progress.h"
#include "report.h"
#include "terse/core/error.h"

namespace terse {

template <class Pose>
Thresholds<Pose> SampleThresholds(const PoseGraph<Pose>& graph, std::optional<double> share, const std::string& label,
                                  bool quiet, CompactOptions<Pose>& settings) {
  Progress progress(label, 0, quiet);
  SampleOptions sample;
  sample.probability = settings.probability;
  sample.distance = settings.distance;
  sample.innovation_quantile = settings.innovation_quantile;
  if (share) {
    sample.share = *share;
    sample.most_poses = std::numeric_limits<long>::max();
  }
  sample.progress = [&](long done, long) { progress.Update(done); };
  const Thresholds<Pose> chosen = SelectThresholds(graph, sample);
  settings.range = chosen.range;
  settings.min_loop_gain = chosen.min_loop_gain;
  settings.min_pose_gain = chosen.min_pose_gain;
  settings.link_covariance = chosen.link_covariance;
  return chosen;
}

template <class Pose>
double CompactRun<Pose>::Seconds() const {
  return std::accumulate(step_seconds.begin(), step_seconds.end(), 0.0);
}

template <class Pose>
CompactRun<Pose> RunCompact(const CompactOptions<Pose>& settings, GraphReplay<Pose>& replay,
                            const CompactRunOptions<Pose>& options) {
  CompactRun<Pose> run{CompactPoseSlam<Pose>(settings), {}, {}, 0, 0, {}};
  {
    Progress progress(options.label, static_cast<long>(replay.Inputs().size()), options.quiet);
    const Registration<Pose> registration = replay.AsRegistration();
    for (const auto& input : replay.Inputs()) {
      const double before = SecondsNow();
      run.decisions.push_back(run.slam.AddPose(input, registration));
      run.step_seconds.push_back(SecondsNow() - before);
      run.links_refused += run.decisions.back().links_refused;
      run.registrations_tried += run.decisions.back().registrations_tried;
      if (options.after_step) options.after_step(run.slam, run.decisions.back(), run.step_seconds.back());
      progress.Update(static_cast<long>(run.decisions.size()));
    }
  }
  run.result = run.slam.Finish();
  if (run.result.termination == Termination::kNotPositiveDefinite || run.result.termination == Termination::kDiverged) {
    throw NumericalError(run.result.message);
  }
  return run;
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template Thresholds<Pose> SampleThresholds<Pose>(const PoseGraph<Pose>&, std::optional<double>, const std::string&, \
                                                   bool, CompactOptions<Pose>&);                                      \
  template struct CompactRun<Pose>;                                                                                   \
  template CompactRun<Pose> RunCompact<Pose>(const CompactOptions<Pose>&, GraphReplay<Pose>&,                         \
                                             const CompactRunOptions<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
