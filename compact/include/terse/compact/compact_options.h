#pragma once
// What compact pose SLAM is told: options, poses with their measurements, and who registers links.

#include <functional>
#include <optional>
#include <vector>

#include "terse/compact/distance.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/core/incremental_solver.h"

namespace terse {

// kApal: all poses, all links. kApfl: all poses, those links that pass the tests. kFpfl: few poses, few links. kRfpfl:
// the poses and links that the input names, drawn at random beforehand (GraphReplay::DrawAtRandom): the baseline.
enum class Strategy { kApal, kApfl, kFpfl, kRfpfl };
const char* Name(Strategy strategy);

template <class Pose>
struct CompactOptions {
  Strategy strategy = Strategy::kFpfl;
  // v. Sensor range per dimension of the displacement: metres, then radians.
  Vector<Displacement<Pose>::kSize> range = Vector<Displacement<Pose>::kSize>::Constant(1);
  double probability = 0.1;  // s: every dimension must be in range with more than this
  // g_loop, g_pose, nats. These keep much: SelectThresholds (thresholds.h) takes at least 0.5 and 0.9 nats per degree
  // of freedom, 3 and 5.4 in 3D, and the range from the data too.
  double min_loop_gain = 1.0;
  double min_pose_gain = 3.0;
  // Covariance expected of a registration, body frame of the newer pose.
  typename Pose::Jacobian link_covariance = 0.01 * Pose::Jacobian::Identity();
  DistanceOptions distance;                                 // how angles are measured, 3D only
  CompositionOrder composition = CompositionOrder::kFirst;  // of the chains over dropped poses
  // A link whose innovation a correct one exceeds with less than the remaining probability is taken for wrong, before
  // its information counts. Absent: no test. AddPose of kApal and kRfpfl does not test.
  std::optional<double> innovation_quantile = 0.9999;
  // So many refused links of different poses that agree with each other are right after all: it is the map that is off,
  // as after odometry that was worse than its covariance says. At least 2.
  int consensus = 3;
  IncrementalOptions solver;
  LogSink log;  // log.h; the solver's too, unless that has its own
};

// Measures T_candidate_current, given in either direction; nullopt when the two do not match.
template <class Pose>
using Registration = std::function<std::optional<RelativePoseFactor<Pose>>(PoseId candidate, PoseId current)>;

template <class Pose>
struct CompactInput {
  PoseId id;
  // To an earlier pose, kept or dropped, in either direction. Absent for the very first pose only.
  std::optional<RelativePoseFactor<Pose>> odometry;
  std::optional<Pose> T_world_body = std::nullopt;  // of the first pose (default identity) and of fixed ones
  bool fixed = false;                               // kept, and anchored at T_world_body
  std::vector<Factor<Pose>> priors;                 // on this pose; a pose with priors is kept
  // The poses known to be linkable, if known: kApal and kRfpfl register these (twice if named twice) instead of
  // searching.
  std::optional<std::vector<PoseId>> linkable = std::nullopt;
  bool drawn = false;  // kRfpfl: keep it
};

}  // namespace terse
