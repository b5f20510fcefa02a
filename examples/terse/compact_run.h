#pragma once
// A stored graph through compact pose SLAM from its first pose to its last.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "terse/compact/thresholds.h"

namespace terse {

// Puts thresholds from a sample of the graph (SelectThresholds) into `settings`, under a progress line: range, gains
// and the link covariance they go with. Their probability, distance and innovation quantile are those of the sample.
// `share`: of the poses; by default SelectThresholds's own. Returns what they were chosen by.
template <class Pose>
Thresholds<Pose> SampleThresholds(const PoseGraph<Pose>& graph, std::optional<double> share, const std::string& label,
                                  bool quiet, CompactOptions<Pose>& settings);

template <class Pose>
struct CompactRun {
  CompactPoseSlam<Pose> slam;
  std::vector<Decision> decisions;
  std::vector<double> step_seconds;  // of AddPose
  int registrations_tried = 0, links_refused = 0;
  BatchResult<Pose> result;  // of the kept graph

  int PosesKept() const { return static_cast<int>(slam.Solver().Graph().Poses().size()); }
  double Seconds() const;  // of all steps; reading and the closing iterations are not counted
};

template <class Pose>
struct CompactRunOptions {
  std::string label = "poses";  // of the progress line
  bool quiet = false;
  // Called after every step with the seconds it took; its own time is not counted.
  std::function<void(const CompactPoseSlam<Pose>&, const Decision&, double seconds)> after_step;
};

// Throws NumericalError if the kept map has no optimum, and what AddPose throws.
template <class Pose>
CompactRun<Pose> RunCompact(const CompactOptions<Pose>& settings, GraphReplay<Pose>& replay,
                            const CompactRunOptions<Pose>& options = {});

}  // namespace terse
