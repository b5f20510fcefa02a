#pragma once
// The chains of dropped poses in a map some of whose kept poses are dropped now (retire_poses.h).

#include <optional>
#include <unordered_map>
#include <vector>

#include "terse/compact/compact_map.h"

namespace terse::internal {

template <class Pose>
class RetiredChains {
 public:
  using SeenPose = typename CompactMap<Pose>::SeenPose;

  // A view: the poses are changed where they are.
  RetiredChains(std::vector<SeenPose>& poses, CompositionOrder order);

  const SeenPose& Find(PoseId id) const { return poses_[Place(id)]; }
  bool IsOlder(PoseId a, PoseId b) const { return Place(a) < Place(b); }
  PoseId NewerOf(PoseId a, PoseId b) const { return IsOlder(a, b) ? b : a; }
  // The kept pose that the chain of this one starts from; absent of the first.
  std::optional<PoseId> KeptBefore(PoseId kept) const;
  // What the chain from there to the pose measures, if dropped poses are between the two and remember it.
  std::optional<UncertainPose<Pose>> ChainTo(PoseId kept) const;

  // The pose hangs on `base` from now on, its KeptBefore; with all that hung on it, and what ended there ends where the
  // odometry leads on to, or at `base`. `spent`: what the chain measured is in other factors of the map too.
  struct Next {
    PoseId id;
    UncertainPose<Pose> T_pose_next;
  };
  void Drop(PoseId pose, PoseId base, const UncertainPose<Pose>& T_base_pose, const std::optional<Next>& next,
            bool spent);

 private:
  std::size_t Place(PoseId id) const { return place_.at(id.value); }
  std::optional<PoseId> ParentOf(const SeenPose& pose) const;
  std::vector<std::size_t> DroppedBefore(std::size_t at) const;
  void MoveHanging(PoseId pose, PoseId base, const UncertainPose<Pose>& T_base_pose);
  void MoveEnds(PoseId pose, PoseId base, const UncertainPose<Pose>& T_base_pose, const std::optional<Next>& next);
  void JoinStretches(PoseId pose, const std::vector<std::size_t>& behind, bool spent);

  std::vector<SeenPose>& poses_;
  CompositionOrder order_;
  std::unordered_map<std::int64_t, std::size_t> place_;
  // Dropped poses by the kept one that they hang on, and that their chain ends at.
  std::unordered_map<std::int64_t, std::vector<std::size_t>> hanging_, ending_;
};

}  // namespace terse::internal
