#pragma once
// The thresholds in force: those of the options, or, with a budget (CompactBudget), what makes the map keep the share
// that was asked for.

#include "terse/compact/compact_options.h"

namespace terse {

// A threshold is the option's times exp(2 x), x by how much more than its share the map has kept so far, in units of
// what the share is of 100 poses (or loops), between -1 and 3. So the share is met in the long run without a sample, as
// far as factors of e^-2 to e^6 can: where nothing is in range every pose is kept, and what was not kept while there
// was nothing to say is not made up for. A pose may be kept for a loop, so the threshold of loops follows both budgets;
// that of edges, which keep no pose, only the one of links.
class GainControl {
 public:
  double MinLoopGain() const { return min_loop_gain_; }
  double MinPoseGain() const { return min_pose_gain_; }
  double MinEdgeGain() const { return min_edge_gain_; }  // Strategy::kBounded

  template <class Pose>
  void Start(const CompactOptions<Pose>& options);
  // Of a map that has kept so much already: the budget counts from here on.
  void Resume(int poses_kept, int links_kept) {
    poses_kept_ = poses_kept;
    links_kept_ = links_kept;
  }
  // After a pose: how many the map keeps by now, and how many loops came with it. Thresholds of strategies other than
  // kFpfl and kBounded stay.
  template <class Pose>
  void Follow(const CompactOptions<Pose>& options, int poses_kept, int links_kept, int new_loops);

  template <class Archive>
  void Serialize(Archive& archive);

 private:
  double min_loop_gain_ = 0, min_pose_gain_ = 0, min_edge_gain_ = 0;
  double excess_poses_ = 0, excess_links_ = 0;  // kept beyond the share, so many poses and links
  int poses_kept_ = 0, links_kept_ = 0;         // when it was looked at last
};

}  // namespace terse
