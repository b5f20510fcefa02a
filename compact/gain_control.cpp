#include "gain_control.h"

#include <algorithm>
#include <cmath>

#include "terse/compact/state_members.h"

namespace terse {
namespace {

constexpr double kWindow = 100, kSteepness = 2, kMostExcess = 3, kMostByPoses = 0.7;
// Of min_loop_gain: an edge costs less than a pose. (Over 23 graphs 0.1 to 1 make maps as good; the more it is, the
// sooner laps stop bringing new edges. Below a half they go on for tens of laps.)
constexpr double kEdgeGain = 0.7;

// The excess after more was kept of more that there was; and x of gain_control.h.
double Followed(double excess, double share, double kept, int offered) {
  return std::max(excess + kept - share * offered, -kWindow * share);
}

double Exponent(std::optional<double> share, double excess) {
  return share ? kSteepness * std::min(excess / (kWindow * *share), kMostExcess) : 0;
}

}  // namespace

template <class Pose>
void GainControl::Start(const CompactOptions<Pose>& options) {
  *this = GainControl();
  min_loop_gain_ = options.thresholds.min_loop_gain;
  min_pose_gain_ = options.thresholds.min_pose_gain;
  min_edge_gain_ = kEdgeGain * min_loop_gain_;
}

template <class Pose>
void GainControl::Follow(const CompactOptions<Pose>& options, int poses_kept, int links_kept, int new_loops) {
  if (options.strategy != Strategy::kFpfl && options.strategy != Strategy::kBounded) return;
  const auto& [keep_poses, keep_links] = options.budget;
  // In floating point: a damaged state holds any number.
  const double new_poses = 1.0 * poses_kept - poses_kept_, new_links = 1.0 * links_kept - links_kept_;
  poses_kept_ = poses_kept;
  links_kept_ = links_kept;
  if (keep_poses) excess_poses_ = Followed(excess_poses_, *keep_poses, new_poses, 1);
  if (keep_links) excess_links_ = Followed(excess_links_, *keep_links, new_links, new_loops);
  const double of_poses = Exponent(keep_poses, excess_poses_), of_links = Exponent(keep_links, excess_links_);
  const bool both = keep_poses && keep_links;
  min_pose_gain_ = options.thresholds.min_pose_gain * std::exp(of_poses);
  // A map that closes no loops is lost, and then everything is new to it: the budget of poses is not kept that way.
  const double by_poses = std::min(of_poses, kMostByPoses);
  const double of_loops = both ? std::max(by_poses, of_links) : by_poses + of_links;
  min_loop_gain_ = options.thresholds.min_loop_gain * std::exp(of_loops);
  min_edge_gain_ = kEdgeGain * options.thresholds.min_loop_gain * std::exp(of_links);
}

template <class Archive>
void GainControl::Serialize(Archive& archive) {
  auto& [min_loop_gain, min_pose_gain, min_edge_gain, excess_poses, excess_links, poses_kept, links_kept] = *this;
  archive(min_loop_gain, min_pose_gain, min_edge_gain, excess_poses, excess_links, poses_kept, links_kept);
}

template void GainControl::Start(const CompactOptions<SE2>&);
template void GainControl::Start(const CompactOptions<SE3>&);
template void GainControl::Follow(const CompactOptions<SE2>&, int, int, int);
template void GainControl::Follow(const CompactOptions<SE3>&, int, int, int);
template void GainControl::Serialize(StateWriter&);
template void GainControl::Serialize(StateReader&);

}  // namespace terse
