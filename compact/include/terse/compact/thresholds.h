#pragma once
// Thresholds of compact pose SLAM from a sample of a run (Ila et al., IJRR 2017, section 6).

#include "terse/compact/graph_replay.h"

namespace terse {

template <class Pose>
struct Thresholds {
  Vector<Displacement<Pose>::kSize> range;
  double probability = 0.1;
  double min_loop_gain = 0, min_pose_gain = 0;
};

struct SampleOptions {
  double probability = 0.1;  // s
  double share = 0.6;        // of the run's poses
  std::function<void(long done, long total)> progress;
};

// Replays the sample with all poses and links.
// range: the least with which every loop of the sample passes the distance test at s, but at least the replay's
// LinkRange: a map with few links knows its displacements less well than the sample's, so its own loops would fail the
// sample's range and, once they do, all later ones. Without any loop in the sample it is LinkRange.
// Gains: g_loop = exp(1.36 ln(l90 + 1)) - 1 and g_pose = exp(1.7 ln(p90 + 1)) - 1, where l90 and p90 are the 90th
// percentiles of the gains of the links, and of the least gain per pose among its link to the pose before and the
// loops it has. Throws std::invalid_argument if the graph is empty or not connected.
template <class Pose>
Thresholds<Pose> SelectThresholds(const PoseGraph<Pose>& graph, const SampleOptions& options = {});

}  // namespace terse
