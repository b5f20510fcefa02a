#pragma once
// A stored graph through compact pose SLAM (compact_graph.h) under a progress line.

#include <optional>
#include <string>

#include "terse/compact/compact_graph.h"

namespace terse {

// SampleThresholds. `share`: of the poses; by default SelectThresholds's own.
template <class Pose>
SampledThresholds<Pose> SampleWithProgress(const PoseGraph<Pose>& graph, std::optional<double> share,
                                           const std::string& label, bool quiet, CompactOptions<Pose>& settings);

// RunCompact.
template <class Pose>
CompactRun<Pose> RunWithProgress(CompactPoseSlam<Pose> slam, const GraphReplay<Pose>& replay, const std::string& label,
                                 bool quiet, const AfterStep<Pose>& after_step = nullptr);

}  // namespace terse
