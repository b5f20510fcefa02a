#include "retired_chains.h"

#include <algorithm>

namespace terse::internal {

using std::size_t;

namespace {

// As a chain that has not ended; nothing is carried along it any more.
template <class SeenPose>
void LoseEnd(SeenPose& pose) {
  pose.next_kept.reset();
  pose.T_base_next = {};
  pose.ended_by.reset();
  pose.carried = true;
}

}  // namespace

template <class Pose>
RetiredChains<Pose>::RetiredChains(std::vector<SeenPose>& poses, CompositionOrder order)
    : poses_(poses), order_(order) {
  for (size_t at = 0; at < poses.size(); ++at) {
    place_[poses[at].id.value] = at;
    if (poses[at].kept) continue;
    hanging_[poses[at].base.value].push_back(at);
    if (poses[at].next_kept) ending_[poses[at].next_kept->value].push_back(at);
  }
}

template <class Pose>
std::optional<PoseId> RetiredChains<Pose>::ParentOf(const SeenPose& pose) const {
  return pose.anchored_to ? pose.anchored_to : pose.previous;
}

template <class Pose>
std::optional<PoseId> RetiredChains<Pose>::KeptBefore(PoseId kept) const {
  const auto parent = ParentOf(Find(kept));
  return parent ? std::optional<PoseId>(Find(*parent).base) : std::nullopt;
}

template <class Pose>
std::optional<UncertainPose<Pose>> RetiredChains<Pose>::ChainTo(PoseId kept) const {
  const auto parent = ParentOf(Find(kept));
  if (!parent) return std::nullopt;
  const SeenPose& last = Find(*parent);
  if (last.kept || last.ended_by || last.next_kept != kept) return std::nullopt;
  return last.T_base_next;
}

// The dropped poses on the chain of the pose at a place, itself left out, newest first.
template <class Pose>
std::vector<size_t> RetiredChains<Pose>::DroppedBefore(size_t at) const {
  std::vector<size_t> chain;
  for (auto parent = ParentOf(poses_[at]); parent; parent = ParentOf(poses_[chain.back()])) {
    if (Find(*parent).kept) break;
    chain.push_back(Place(*parent));
  }
  return chain;
}

template <class Pose>
void RetiredChains<Pose>::Drop(PoseId pose, PoseId base, const UncertainPose<Pose>& T_base_pose,
                               const std::optional<Next>& next, bool spent) {
  const std::vector<size_t> behind = hanging_[pose.value];
  MoveEnds(pose, base, T_base_pose, next);
  MoveHanging(pose, base, T_base_pose);
  const size_t at = Place(pose);
  SeenPose& dropped = poses_[at];
  dropped.kept = false;
  dropped.base = base;
  dropped.T_base_pose = T_base_pose;
  hanging_[base.value].push_back(at);
  if (next) {
    dropped.next_kept = next->id;
    dropped.T_base_next = Compose(T_base_pose, next->T_pose_next, order_);
    ending_[next->id.value].push_back(at);
  }
  JoinStretches(pose, behind, spent);
}

template <class Pose>
void RetiredChains<Pose>::MoveHanging(PoseId pose, PoseId base, const UncertainPose<Pose>& T_base_pose) {
  const std::vector<size_t> behind = std::move(hanging_[pose.value]);
  hanging_.erase(pose.value);
  for (const size_t at : behind) {
    SeenPose& hung = poses_[at];
    hung.base = base;
    hung.T_base_pose = Compose(T_base_pose, hung.T_base_pose, order_);
    if (hung.next_kept) hung.T_base_next = Compose(T_base_pose, hung.T_base_next, order_);
    hanging_[base.value].push_back(at);
  }
}

// Chains that odometry ended at the pose lead on through it; those that a link ended there go back to its base. The end
// of one that would count the way there twice is lost: of one that starts at the pose itself, or that shares dropped
// poses with that way.
template <class Pose>
void RetiredChains<Pose>::MoveEnds(PoseId pose, PoseId base, const UncertainPose<Pose>& T_base_pose,
                                   const std::optional<Next>& next) {
  const std::vector<size_t> ended = std::move(ending_[pose.value]);
  ending_.erase(pose.value);
  const std::vector<size_t> way = DroppedBefore(Place(pose));
  std::unordered_map<size_t, bool> known;  // poses of one chain ask for the same
  for (const size_t at : way) known[at] = true;
  const auto shares_way = [&](size_t at) {
    std::vector<size_t> asked;
    bool shares = false;
    while (true) {
      if (const auto it = known.find(at); it != known.end()) {
        shares = it->second;
        break;
      }
      asked.push_back(at);
      const auto parent = ParentOf(poses_[at]);
      if (!parent || Find(*parent).kept) break;
      at = Place(*parent);
    }
    for (const size_t each : asked) known[each] = shares;
    return shares;
  };
  const UncertainPose<Pose> T_pose_base = Invert(T_base_pose);
  for (const size_t at : ended) {
    SeenPose& chain = poses_[at];
    if (!chain.ended_by && next) {
      chain.next_kept = next->id;
      chain.T_base_next = Compose(chain.T_base_next, next->T_pose_next, order_);
      ending_[next->id.value].push_back(at);
    } else if (!chain.ended_by) {
      chain.next_kept.reset();
      chain.T_base_next = {};
    } else if (chain.base == pose || shares_way(at)) {
      LoseEnd(chain);
    } else {
      chain.next_kept = base;
      chain.T_base_next = Compose(chain.T_base_next, T_pose_base, order_);
      ending_[base.value].push_back(at);
    }
  }
}

// What comes behind the pose on its chain belongs to its stretch from now on (pose_history.h), which is spent if any
// part of it was. Poses of one stretch say the same; where it starts counts.
template <class Pose>
void RetiredChains<Pose>::JoinStretches(PoseId pose, const std::vector<size_t>& behind, bool spent) {
  SeenPose& middle = poses_[Place(pose)];
  const auto continues = [&](const SeenPose& seen) {
    return !seen.anchored_to && seen.previous && !Find(*seen.previous).kept;
  };
  bool carried = spent || middle.carried;
  std::vector<size_t> stretch = {Place(pose)};
  while (continues(poses_[stretch.back()])) stretch.push_back(Place(*poses_[stretch.back()].previous));
  for (const size_t at : stretch) carried = carried || poses_[at].carried;
  std::vector<size_t> ascending = behind;
  std::sort(ascending.begin(), ascending.end());
  std::unordered_map<std::int64_t, bool> is_on_stretch = {{pose.value, true}};
  for (const size_t at : ascending) {
    const SeenPose& seen = poses_[at];
    if (!continues(seen) || is_on_stretch.count(seen.previous->value) == 0) continue;
    is_on_stretch[seen.id.value] = true;
    stretch.push_back(at);
    carried = carried || seen.carried;
  }
  for (const size_t at : stretch) poses_[at].carried = carried;
}

template class RetiredChains<SE2>;
template class RetiredChains<SE3>;

}  // namespace terse::internal
