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
// min_loop_gain: l90, the 90th percentile of the links' gains before any link of their pose is added. (The paper's
// exp(1.36 ln(l90 + 1)) - 1 belongs to gains recorded while links are added; here it would ask for more than nearly
// every link offers: 24 of the 54 312 of w10000.)
// min_pose_gain: exp(1.7 ln(p90 + 1)) - 1, p90 being the percentile of the least gain per pose among its link to the
// pose before and the loops it has.
// Throws std::invalid_argument if the graph is empty or not connected.
template <class Pose>
Thresholds<Pose> SelectThresholds(const PoseGraph<Pose>& graph, const SampleOptions& options = {});

}  // namespace terse
