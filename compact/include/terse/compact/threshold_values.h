#pragma once
// The thresholds of compact pose SLAM (Ila et al. 2017): what counts as near, and how much has to be told for it to be
// kept. thresholds.h chooses them from a sample of a run, thresholds_file.h stores them.

#include "terse/compact/distance.h"

namespace terse {

template <class Pose>
struct Thresholds {
  // v. Sensor range per dimension of the displacement: metres, then radians.
  Vector<Displacement<Pose>::kSize> range = Vector<Displacement<Pose>::kSize>::Constant(1);
  // s: a pose counts as within range when every dimension is with more than this probability (Ila et al. 2017 Eq. 18).
  double probability = 0.1;
  // g_loop, g_pose, nats. These keep much: SelectThresholds takes at least 0.5 and 0.9 nats per degree of freedom, 3
  // and 5.4 in 3D, and the range from the data too.
  double min_loop_gain = 1.0;
  double min_pose_gain = 3.0;
  // Covariance expected of a registration, body frame of the newer pose.
  typename Pose::Jacobian link_covariance = 0.01 * Pose::Jacobian::Identity();
};

// Those that are chosen by what was measured so far; others stay as they are given.
struct ThresholdChoice {
  bool range = false, min_loop_gain = false, min_pose_gain = false, link_covariance = false;
  bool Any() const { return range || min_loop_gain || min_pose_gain || link_covariance; }
};

}  // namespace terse
