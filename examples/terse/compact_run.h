#pragma once
// A stored graph through compact pose SLAM from its first pose to its last.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "terse/compact/thresholds.h"

namespace terse {

// FPFL with the thresholds, and the link covariance they go with.
template <class Pose>
CompactOptions<Pose> SettingsFrom(const Thresholds<Pose>& thresholds);
// With thresholds from a sample of the graph (SelectThresholds), under a progress line. `share`: of its poses; by
// default SelectThresholds's own.
template <class Pose>
CompactOptions<Pose> SampleSettings(const PoseGraph<Pose>& graph, std::optional<double> share, const std::string& label,
                                    bool quiet);

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
