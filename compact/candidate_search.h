#pragma once
// The search of Algorithm 1: which kept poses may be linked to the pose at hand, and what the links would be worth.
//
// What the map knows of the displacements between all kept poses and one of them, `base`, is worked out once and holds
// until the factor changes, O(kept poses); what hangs on base follows by composition. A tree over the kept poses
// (pose_index.h) then finds those in reach.

#include <cstdint>
#include <vector>

#include "current_pose.h"
#include "kept_map.h"
#include "terse/compact/decision.h"
#include "terse/compact/pose_index.h"

namespace terse::internal {

// A pose that may be linked.
struct Ask {
  int pose = -1;   // solver index
  int offer = -1;  // in CurrentPose::offers; -1: it has to be registered
};

// One with what is known of it.
template <class Pose>
struct Evaluated {
  Ask ask;
  UncertainPose<Pose> T_pose_current;
  Candidate record;
  double worth = 0;       // nats that trying it promises
  bool plausible = true;  // in range, as far as is known
};

template <class Pose>
class CandidateSearch {
 public:
  using Jacobian = typename Pose::Jacobian;

  // Both outlive it.
  CandidateSearch(const CompactOptions<Pose>& options, KeptMap<Pose>& map) : options_(options), map_(map) {}
  // The options have changed.
  void TakeOptions();

  // Kept poses that may be candidates: none that Evaluate takes for one is missing. Ascending. `plausible`: those too
  // whose displacement is only plausibly within range.
  std::vector<Ask> InReach(const CurrentPose<Pose>& current, bool plausible);
  // What is known of the given kept poses, and what trying them promises. Of those that are to be registered only the
  // candidates come back: within range with enough probability, or plausibly so if that is enough.
  std::vector<Evaluated<Pose>> Evaluate(const CurrentPose<Pose>& current, const std::vector<Ask>& asks,
                                        bool plausible) const;
  // A loop that came with the pose, whether it is in range or not.
  Evaluated<Pose> EvaluateOffer(const CurrentPose<Pose>& current, int offer) const;
  // What Evaluate says next comes from the covariances of the poses asked for alone, to the same bits whether a search
  // came before or not.
  void Forget() { base_ = -1; }

 private:
  bool IsReady(int base) const { return version_ == map_.Solver().Cholesky().Version() && base_ == base; }
  void MakeReady(int base);
  UncertainPose<Pose> KnownDisplacement(int pose, int base) const;
  UncertainPose<Pose> DisplacementAt(int pose, int base, const Jacobian& cross) const;

  const CompactOptions<Pose>& options_;
  KeptMap<Pose>& map_;        // only its covariances are brought up to date
  double most_distance_ = 0;  // squared, of the range from the mean of a plausible displacement
  // Of the factor's version_, from all kept poses to the one of index base_. Nothing of it is stored: it is worked out
  // again to the same bits.
  std::vector<UncertainPose<Pose>> T_pose_base_;
  PoseIndex<Pose> reach_;
  std::uint64_t version_ = 0;
  int base_ = -1;
};

}  // namespace terse::internal
