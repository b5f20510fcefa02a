#include "run/compact_run.h"

#include <limits>

#include "run/progress.h"

namespace terse {

template <class Pose>
SampledThresholds<Pose> SampleWithProgress(const PoseGraph<Pose>& graph, std::optional<double> share,
                                           const std::string& label, bool quiet, CompactOptions<Pose>& settings) {
  Progress progress(label, 0, quiet);
  SampleOptions sample;
  if (share) {
    sample.share = *share;
    sample.most_poses = std::numeric_limits<long>::max();
  }
  sample.progress = [&](long done, long) { progress.Update(done); };
  return SampleThresholds(graph, settings, sample);
}

template <class Pose>
CompactRun<Pose> RunWithProgress(CompactPoseSlam<Pose> slam, const GraphReplay<Pose>& replay, const std::string& label,
                                 bool quiet, const AfterStep<Pose>& after_step) {
  Progress progress(label, static_cast<long>(replay.Inputs().size()), quiet);
  long done = 0;
  return RunCompact<Pose>(std::move(slam), replay,
                          [&](const CompactPoseSlam<Pose>& running, const Decision& decision, double seconds) {
                            if (after_step) after_step(running, decision, seconds);
                            progress.Update(++done);
                          });
}

#define TERSE_INSTANTIATE(Pose)                                                                                        \
  template SampledThresholds<Pose> SampleWithProgress<Pose>(const PoseGraph<Pose>&, std::optional<double>,             \
                                                            const std::string&, bool, CompactOptions<Pose>&);          \
  template CompactRun<Pose> RunWithProgress<Pose>(CompactPoseSlam<Pose>, const GraphReplay<Pose>&, const std::string&, \
                                                  bool, const AfterStep<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
