#pragma once
// The thresholds in force: those of the options, or, with a budget (CompactBudget), what makes the map keep the share
// that was asked for.

#include "terse/compact/compact_options.h"
#include "terse/compact/error_growth.h"
#include "terse/compact/explored_area.h"

namespace terse {

// A threshold is the option's times exp(2 x), x between -1 and 3, by what the budget asks for:
//  - keep_poses, keep_links: by how much more than its share the map has kept so far, in units of what the share is of
//    100 poses (or loops). So the share is met in the long run without a sample, as far as factors of e^-2 to e^6 can:
//    where nothing is in range every pose is kept, and what was not kept while there was nothing to say is not made up
//    for.
//  - poses_per_area: by how much more than its number the map keeps now, in units of a tenth of it. It counts what the
//    map has, so where poses go others may come.
//  - error: by the logarithm of what is asked for over the growth of the error that is found (ErrorGrowth), of both
//    less 1, whenever more loops have been seen or left out. x starts at -1, rises slowly while less is found, to 0.5
//    at most, and falls at once where it is more, to -2: the loops that were left out do not come again.
// A pose may be kept for a loop, so the threshold of loops follows the budgets of both; that of edges, which keep no
// pose, only those of links and error.
template <class Pose>
class GainControl {
 public:
  double MinLoopGain() const { return min_loop_gain_; }
  double MinPoseGain() const { return min_pose_gain_; }
  double MinEdgeGain() const { return min_edge_gain_; }  // Strategy::kBounded

  void Start(const CompactOptions<Pose>& options);
  // Of a map that has kept so much already: shares count from here on; density and error, of the whole map, do as far
  // as is known. `T_world_body`: of all poses seen.
  void Resume(const CompactOptions<Pose>& options, int poses_kept, int links_kept,
              const std::vector<Pose>& T_world_body);

  // That the map has above a budget of poses; 0 without one.
  int PosesTooMany(const CompactBudget& budget) const;

  struct Kept {
    int poses = 0, links = 0;  // of the map by now
    int new_loops = 0;         // that came with the pose,
    int loops_used = 0;        // and are in the map; of those that were measured
    bool is_kept = false;      // the pose itself
  };
  // After a pose. Thresholds of strategies other than kFpfl and kBounded stay.
  void Follow(const CompactOptions<Pose>& options, const Kept& kept, const Pose& T_world_body);
  // Before that, with CompactBudget::error.
  void FollowError(const CompactOptions<Pose>& options, const SeenLoops<Pose>& seen, const Kept& kept,
                   const IncrementalSolver<Pose>& solver, const std::function<bool(FactorId)>& is_link);

  template <class Archive>
  void Serialize(Archive& archive);

 private:
  void Enter(const CompactOptions<Pose>& options, const Pose& T_world_body);
  double WantedPoses(double poses_per_area) const { return poses_per_area * static_cast<double>(cells_.Count()); }
  double DensityExponent(double poses_per_area, int poses) const;

  double min_loop_gain_ = 0, min_pose_gain_ = 0, min_edge_gain_ = 0;
  double excess_poses_ = 0, excess_links_ = 0;  // kept beyond the share, so many poses and links
  int poses_kept_ = 0, links_kept_ = 0;         // when it was looked at last
  EnteredCells cells_;                          // with poses_per_area; around the first pose
  ErrorGrowth<Pose> growth_;                    // with error
  double error_sum_ = 0, error_exponent_ = 0;
};

extern template class GainControl<SE2>;
extern template class GainControl<SE3>;

}  // namespace terse
