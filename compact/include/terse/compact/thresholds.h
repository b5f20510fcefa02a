#pragma once
// Thresholds of compact pose SLAM from a sample of a run (Ila et al. 2017 section 6).

#include <optional>

#include "terse/compact/graph_replay.h"
#include "terse/compact/threshold_values.h"

namespace terse {

// Thresholds, and what they were chosen by.
template <class Pose>
struct SampledThresholds {
  Thresholds<Pose> thresholds;                // link_covariance: the mean of the graph's links
  double loop_gain_90 = 0, pose_gain_90 = 0;  // l90, p90, nats
  long sample_poses = 0;                      // looked at
  long sample_loops = 0;                      // of theirs looked at, at most 12 of a pose
  long sample_links = 0;                      // that the sample's map was made of, at most 4 of a pose
};

struct SampleOptions {
  double probability = 0.1;  // s
  double share = 0.6;  // of the run's poses are looked at, spread over the run (the first 5000 poses of a longer one)
  long most_poses = 200;  // but no more than so many
  DistanceOptions distance;
  // That the thresholds are for: a bounded map asks links for less than the least that min_loop_gain is of others.
  // There an edge is no pose, what fuses costs nothing, and what is too much retires.
  Strategy strategy = Strategy::kBounded;
  // Loops whose innovation exceeds this quantile (CompactOptions::innovation_quantile) are left out of the sample: for
  // graphs with wrong loops, whose covariances are right. Absent: all loops are taken for true.
  std::optional<double> innovation_quantile;
  std::function<void(long done, long total)> progress;
};

// The poses that a sample looks at: one drawn from each of `count` (at most `poses`) equal parts of the run, the same
// ones every time. Ascending, from 0.
std::vector<long> SamplePositions(long poses, long count);

// Replays the run up to the last pose that is looked at. All poses join the sample's map, but few of a pose's links,
// each with the information of those that it stands for, so that time and memory do not grow with the number of links.
// range: the replay's LinkRange, that is, the sensor's own, by what all links of the run measure; if the innovation
// test refuses more than one in fifty of the sample's map, by those of this map. The map's uncertainty has no part in
// it: a displacement may be far beyond the range and still be plausibly within. min_loop_gain: exp(1.36 ln(l90 + 1)) -
// 1, l90 being the 90th percentile of the links' gains as Algorithm 1 would add them, best first and the rest evaluated
// again after each; between 1/2 and 1.5 nats per degree of freedom, where there is a loop at every second pose or more.
// Strategy::kBounded: 0.425 nats, since what is too much retires. Where loops are rare each costs the map next to
// nothing and may be all that there is about a part of it: the upper bound falls to 0.02 nats with the loops per pose
// (to the power of 1.5). min_pose_gain: exp(1.7 ln(p90 + 1)) - 1, p90 being the percentile of the least gain per pose
// among its link to the pose before and the loops it has; at least 0.9 nat per degree of freedom, about what a
// registration tells of a displacement known half as well (in standard deviations) as it measures, and 0.9 of what
// min_loop_gain would be if loops were not rare. The bounds are ours: where links are many or odometry is good, as on
// kitti00_all_loops, the percentiles are those of gains that say next to nothing. Throws std::invalid_argument if the
// graph is empty or not connected.
template <class Pose>
SampledThresholds<Pose> SelectThresholds(const PoseGraph<Pose>& graph, const SampleOptions& options = {});

}  // namespace terse
