#pragma once
// What compact pose SLAM is told: options, poses with their measurements, and who registers links.

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "terse/compact/distance.h"
#include "terse/compact/threshold_values.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/core/incremental_solver.h"

namespace terse {

// kApal: all poses, all links. kApfl: all poses, those links that pass the tests. kFpfl: few poses, few links. kGiven:
// the poses and links that the input names (CompactInput::keep, loops), however they were chosen. kBounded: as many as
// the area needs, however often it is passed (compact_pose_slam.h). Saved states hold the numbers: new values come
// last.
enum class Strategy { kApal, kApfl, kFpfl, kGiven, kBounded };
const char* Name(Strategy strategy);

// What a Decision keeps of the search: nothing but counts, what was registered, or also the best of what was not.
enum class Record { kNone, kDecisions, kCandidates };

// CompactOptions::innovation_quantile unless told otherwise: with information as it is stated, and with information
// that was scaled to agree with the residuals (information_scale.h), which is an estimate itself.
inline constexpr double kInnovationQuantile = 0.9999, kInnovationQuantileOfScaled = 0.99999999;

// What the map is to keep in the long run, instead of gains: the thresholds of the options are where the run starts,
// and follow (Strategy::kFpfl and kBounded). Where there is nothing to say less is kept.
struct CompactBudget {
  // Shares, above 0 and at most 1.
  std::optional<double> keep_poses;  // of the poses seen
  std::optional<double> keep_links;  // of the loops that came measured or were registered
  // Kept poses per cell of AreaCell() that the robot has been in, positive: per square as wide as the sensor's range.
  // Not with keep_poses.
  std::optional<double> poses_per_area;
  // How much larger than that of a map with all loops the expected position error may be, above 1: the ratio of root
  // mean squares over the kept poses, as covariances tell. Alone: what it takes is kept.
  std::optional<double> error;
};

// "", or what of a budget is out of its domain, contradicts itself, or cannot be kept with the strategy.
std::string FindDefect(const CompactBudget& budget, Strategy strategy);

// The side of the cells that CompactBudget::poses_per_area counts: the greatest range, metres.
template <class Pose>
double AreaCell(const Thresholds<Pose>& thresholds) {
  return thresholds.range.template head<Pose::kDim>().maxCoeff();
}

template <class Pose>
struct CompactOptions {
  Strategy strategy = Strategy::kBounded;
  Thresholds<Pose> thresholds;
  CompactBudget budget;
  // kBounded: the share of the expected squared position error that a link or an edge must take from the map besides
  // telling it enough nats, from 0 (not asked) to below 1. It is what remains after the best alignment, to first order
  // (A-optimality without the gauge).
  double min_variance_drop = 0;
  // kBounded: as the map grows, kept poses retire whose removal loses no more than this share of min_loop_gain
  // (retire_poses.h); 0: none. Whenever it has grown by a tenth and 50 poses, so the time of a step is one of the whole
  // map then, and a small part of the run's. Not with a robust kernel, nor with CompactBudget::error; with a budget of
  // poses only what is above it.
  double retire_share = 0.3;
  // A pose is a candidate for a link when it is within range (Thresholds::probability), or when the range meets the
  // ellipsoid that holds the displacement with this probability: a map that has drifted far knows no displacement well,
  // and that is when it needs its loops. The probability of being in range then says in which order they are
  // registered.
  double plausible_quantile = 0.9999;
  // Registrations per pose, at most; at least 1. The most information that can be expected of one comes first.
  int max_registrations = 8;
  // Where a registration failed lately, no other is tried between poses that lie within this share of the sensor range
  // of the two: they look the same to the sensor.
  double failed_neighbourhood = 0.25;
  DistanceOptions distance;                                 // how angles are measured, 3D only
  CompositionOrder composition = CompositionOrder::kFirst;  // of the chains over dropped poses
  // A link whose innovation a correct one exceeds with less than the remaining probability is taken for wrong, before
  // its information counts. Absent: no test. AddPose of kApal and kGiven does not test.
  std::optional<double> innovation_quantile = kInnovationQuantile;
  // So many refused links of different poses that agree with each other are right after all: it is the map that is off,
  // as after odometry that was worse than its covariance says. At least 2.
  int consensus = 3;
  Record record = Record::kCandidates;
  int most_recorded = 16;  // kCandidates: so many of those that were not registered
  // For runs without an end: so many of the newest dropped poses are remembered, at least 1; and those before that the
  // chains of kept or newer ones lead through. Others are forgotten, with the trajectory that they were part of: loops
  // to them are counted (Decision::loops_forgotten) and left out. Memory then grows with the map alone, as far as ids
  // ascend; nothing is forgotten else. Absent: all are remembered.
  std::optional<int> most_dropped;
  IncrementalOptions solver;
  LogSink log;  // log.h; the solver's too, unless that has its own
};

// Measures T_candidate_current, given in either direction; nullopt when the two do not match. An empty function
// registers nothing.
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
  // Loops measured already, from this pose to earlier ones, kept or dropped, in either direction; if they are given,
  // nothing else is registered. One to a dropped pose is carried to the kept pose which that hangs on. Each is used
  // once.
  std::optional<std::vector<RelativePoseFactor<Pose>>> loops = std::nullopt;
  // The poses known to be linkable, if known: kApal and kGiven register these (twice if named twice) instead of
  // searching. Without `loops` only.
  std::optional<std::vector<PoseId>> linkable = std::nullopt;
  bool keep = false;  // kGiven
};

}  // namespace terse
