#include "pose_history.h"

#include <algorithm>
#include <stdexcept>

#include "chains.h"
#include "terse/compact/state_members.h"
#include "terse/core/at.h"
#include "terse/core/pose_name.h"

namespace terse::internal {
namespace {

constexpr long kMostForgotten = 2000000000;  // as a count of poses seen

}  // namespace

template <class Pose>
int PoseHistory<Pose>::IndexOf(PoseId id) const {
  const auto it = index_.find(id.value);
  if (it == index_.end()) {
    throw std::invalid_argument(Name(id) +
                                (IsForgotten(id) ? " is forgotten: it was dropped long ago" : " was never added"));
  }
  return it->second;
}

template <class Pose>
bool PoseHistory<Pose>::IsForgotten(PoseId id) const {
  return forgotten_ > 0 && !IsEmpty() && !Has(id) && seen_.front().id < id && id < seen_.back().id;
}

// Which stretch the pose at a place belongs to.
template <class Pose>
int PoseHistory<Pose>::StretchAt(int place) const {
  const Seen& seen = (*this)[place];
  if (seen.kept) return -1;
  const Seen& parent = (*this)[seen.parent];
  return seen.anchored || parent.kept ? place : parent.stretch;
}

// The stretch that the one which starts here hangs on, where a link to a dropped pose starts it; -1 at a kept pose.
template <class Pose>
int PoseHistory<Pose>::StretchBefore(int stretch) const {
  return (*this)[(*this)[stretch].parent].stretch;
}

template <class Pose>
void PoseHistory<Pose>::Append(Seen seen, std::optional<PoseId> previous, std::optional<PoseId> parent) {
  const int place = Size();
  if (previous) seen.previous = IndexOf(*previous);
  if (parent) seen.parent = IndexOf(*parent);
  if (seen.parent >= 0) ++Mutable(seen.parent).successors;
  ascends_ = ascends_ && (IsEmpty() || Newest() < seen.id);
  index_[seen.id.value] = place;
  seen_.push_back(std::move(seen));
  Seen& appended = seen_.back();
  appended.stretch = StretchAt(place);
  appended.carried = appended.carried && appended.stretch == place;
}

template <class Pose>
void PoseHistory<Pose>::EndChain(PoseId last, PoseId next, const UncertainPose<Pose>& T_base_next,
                                 std::optional<PoseId> by) {
  const int ended_by = by ? IndexOf(*by) : -1;
  for (int k = IndexOf(last); !(*this)[k].kept; k = (*this)[k].parent) {
    Seen& dropped = Mutable(k);
    if (dropped.next_kept) break;
    dropped.next_kept = next;
    dropped.T_base_next = T_base_next;
    dropped.ended_by = ended_by;
  }
}

// The chain of a dropped pose as one that has not ended; nothing is carried along it any more, as what came of the rest
// of it is in the map.
template <class Pose>
void PoseHistory<Pose>::LoseEnd(int place) {
  Seen& seen = Mutable(place);
  seen.next_kept.reset();
  seen.T_base_next = {};
  seen.ended_by = -1;
  SpendChain(seen.id);
}

template <class Pose>
void PoseHistory<Pose>::Forget(int most_dropped) {
  if (!ascends_ || Size() - size_when_swept_ <= std::max(most_dropped, size_when_swept_ / 2)) return;
  std::vector<bool> stays(seen_.size(), false);
  int dropped = 0;
  for (int at = Size() - 1; at >= 0; --at) {
    const Seen& seen = (*this)[at];
    if (seen.kept || dropped < most_dropped) stays[At(at)] = true;
    dropped += !seen.kept;
    if (stays[At(at)] && seen.parent >= 0) stays[At(seen.parent)] = true;
  }
  // Where a link has ended a chain, the rest of the chain may go while some of it stays.
  for (int at = 0; at < Size(); ++at) {
    const int by = (*this)[at].ended_by;
    if (stays[At(at)] && by >= 0 && !(stays[At(by)] && stays[At((*this)[by].previous)])) LoseEnd(at);
  }
  Erase(stays);
  size_when_swept_ = Size();
}

template <class Pose>
void PoseHistory<Pose>::Erase(const std::vector<bool>& stays) {
  std::vector<int> place(seen_.size(), -1);
  int next = 0;
  for (size_t at = 0; at < seen_.size(); ++at) {
    if (stays[at]) place[at] = next++;
  }
  const auto move = [&](int& at) {
    if (at >= 0) at = place[At(at)];
  };
  for (size_t at = 0; at < seen_.size(); ++at) {
    Seen& seen = seen_[at];
    if (!stays[at]) {
      index_.erase(seen.id.value);
      continue;
    }
    for (int* reference : {&seen.previous, &seen.parent, &seen.ended_by, &seen.stretch}) move(*reference);
    seen.successors = 0;
    index_[seen.id.value] = place[at];
    if (seen.parent >= 0) ++Mutable(seen.parent).successors;  // moved already
    if (At(place[at]) != at) seen_[At(place[at])] = std::move(seen);
  }
  forgotten_ += static_cast<long>(seen_.size()) - next;
  seen_.resize(At(next));
}

template <class Pose>
void PoseHistory<Pose>::Revive(const Revival<Pose>& revival, FactorId odometry) {
  const int at = IndexOf(revival.pose);
  Seen& pose = Mutable(at);
  std::vector<int> behind_it;
  for (int k = IndexOf(revival.newest); k != at; k = (*this)[k].parent) {
    Seen& seen = Mutable(k);
    const auto behind = Behind(revival.T_base_pose, seen.T_base_pose);
    const Pose T_pose_seen = revival.T_base_pose.T_a_b.Inverse() * seen.T_base_pose.T_a_b;
    seen.base = revival.pose;
    // Where only rounding is left, the two are one.
    seen.T_base_pose = behind.value_or(UncertainPose<Pose>{T_pose_seen});
    if (revival.next) seen.T_base_next = revival.T_pose_next;
    behind_it.push_back(k);
  }
  for (auto k = behind_it.rbegin(); k != behind_it.rend(); ++k) {
    Seen& seen = Mutable(*k);
    if (seen.anchored) continue;
    const Seen& parent = (*this)[seen.parent];
    seen.carried = seen.parent == at && (*this)[pose.stretch].carried;
    seen.stretch = seen.parent == at ? *k : parent.stretch;
  }
  for (int k = pose.parent; !(*this)[k].kept; k = (*this)[k].parent) {
    Seen& seen = Mutable(k);
    if (seen.next_kept != revival.next) continue;
    seen.next_kept = revival.pose;
    seen.T_base_next = revival.T_base_pose;
  }
  pose.kept = true;
  pose.base = revival.pose;
  pose.T_base_pose = {};
  pose.stretch = -1;
  pose.next_kept.reset();
  pose.T_base_next = {};
  pose.odometry = odometry;
}

template <class Pose>
bool PoseHistory<Pose>::IsPlainChain(PoseId dropped, PoseId newest, int successors_of_newest) const {
  const int last = IndexOf(newest);
  for (int k = last; !(*this)[k].kept; k = (*this)[k].parent) {
    if ((*this)[k].successors > (k == last ? successors_of_newest : 1)) return false;
    if ((*this)[k].id == dropped) return true;
  }
  return false;
}

template <class Pose>
std::vector<PoseId> PoseHistory<Pose>::ChainTo(PoseId kept) const {
  int k = Find(kept).parent;
  if (k < 0 || (*this)[k].kept) return {};
  std::vector<PoseId> chain = {kept};
  for (; !(*this)[k].kept; k = (*this)[k].parent) chain.push_back((*this)[k].id);
  chain.push_back((*this)[k].id);
  std::reverse(chain.begin(), chain.end());
  return chain;
}

template <class Pose>
bool PoseHistory<Pose>::IsSpent(PoseId id) const {
  for (int s = Find(id).stretch; s >= 0; s = StretchBefore(s)) {
    if ((*this)[s].carried) return true;
  }
  return false;
}

template <class Pose>
void PoseHistory<Pose>::SpendChain(PoseId id) {
  for (int s = Find(id).stretch; s >= 0; s = StretchBefore(s)) Mutable(s).carried = true;
}

template <class Pose>
int PoseHistory<Pose>::EndedBefore(PoseId id) const {
  int k = IndexOf(id);
  while (!(*this)[k].kept && !(*this)[k].next_kept) k = (*this)[k].parent;
  return (*this)[k].kept ? -1 : k;
}

template <class Pose>
int PoseHistory<Pose>::ParentOnChain(int end) const {
  return end < Size() ? (*this)[end].parent : (*this)[end - Size()].previous;
}

template <class Pose>
std::vector<typename PoseHistory<Pose>::SeenPose> PoseHistory<Pose>::Export() const {
  std::vector<SeenPose> poses;
  poses.reserve(seen_.size());
  for (const Seen& seen : seen_) {
    SeenPose pose;
    pose.id = seen.id;
    pose.kept = seen.kept;
    pose.T_world_body_when_seen = seen.T_world_body_when_seen;
    if (seen.previous >= 0) pose.previous = (*this)[seen.previous].id;
    pose.base = seen.base;
    pose.T_base_pose = seen.T_base_pose;
    pose.next_kept = seen.next_kept;
    pose.T_base_next = seen.T_base_next;
    if (seen.anchored) pose.anchored_to = (*this)[seen.parent].id;
    if (seen.ended_by >= 0) pose.ended_by = (*this)[seen.ended_by].id;
    pose.carried = seen.stretch >= 0 && (*this)[seen.stretch].carried;
    poses.push_back(std::move(pose));
  }
  return poses;
}

template <class Pose>
void PoseHistory<Pose>::Restore(const std::vector<SeenPose>& poses, long forgotten) {
  forgotten_ = forgotten;
  for (const SeenPose& pose : poses) {
    Seen seen;
    seen.id = pose.id;
    seen.kept = pose.kept;
    seen.base = pose.base;
    seen.T_world_body_when_seen = pose.T_world_body_when_seen;
    seen.anchored = pose.anchored_to.has_value();
    seen.carried = pose.carried;
    if (!pose.kept) {
      seen.T_base_pose = pose.T_base_pose;
      seen.next_kept = pose.next_kept;
      if (pose.next_kept) seen.T_base_next = pose.T_base_next;
    }
    Append(std::move(seen), pose.previous, pose.anchored_to ? pose.anchored_to : pose.previous);
  }
  for (const SeenPose& pose : poses) {
    if (pose.ended_by) Mutable(pose.id).ended_by = IndexOf(*pose.ended_by);
  }
}

template <class Pose>
template <class Archive>
void PoseHistory<Pose>::Serialize(Archive& archive) {
  auto& [all, index, forgotten, size_when_swept, ascends] = *this;
  archive.Each(all, [&](Seen& seen) {
    auto& [id, base, T_base_pose, T_world_body_when_seen, previous, parent, successors, kept, anchored, next_kept,
           T_base_next, ended_by, stretch, carried, odometry] = seen;
    archive(id, base, T_base_pose, T_world_body_when_seen, previous, parent, successors, kept, anchored, next_kept,
            T_base_next, ended_by, stretch, carried, odometry);
  });
  if constexpr (Archive::kReads) {
    index.clear();
    for (const Seen& seen : all) {
      if (!index.emplace(seen.id.value, static_cast<int>(index.size())).second) archive.Fail("a pose comes twice");
    }
  }
  archive(forgotten, size_when_swept, ascends);
}

template <class Pose>
std::string PoseHistory<Pose>::FindStateDefect(const PoseGraph<Pose>& kept) const {
  const bool counts = forgotten_ >= 0 && forgotten_ <= kMostForgotten && (forgotten_ == 0 || !IsEmpty()) &&
                      size_when_swept_ >= 0 && size_when_swept_ <= Size();
  if (!counts) return "a wrong count of poses forgotten";
  std::vector<int> successors(seen_.size(), 0);
  for (int at = 0; at < Size(); ++at) {
    const Seen& seen = (*this)[at];
    if (forgotten_ > 0 && at > 0 && !((*this)[at - 1].id < seen.id)) return "ids that do not ascend";
    const bool is_known = kept.HasPose(seen.base) && seen.kept == (seen.id == seen.base) &&
                          (!seen.next_kept || kept.HasPose(*seen.next_kept));
    const bool knows_previous = seen.previous >= 0 || (seen.anchored && forgotten_ > 0);
    const bool has_chain = seen.previous < at && knows_previous == (at > 0) && seen.parent < at &&
                           (seen.parent < 0) == (at == 0) && (seen.anchored || seen.parent == seen.previous);
    const bool has_end =
        seen.ended_by < Size() &&
        (seen.ended_by < 0 || ((*this)[seen.ended_by].anchored && (*this)[seen.ended_by].previous >= 0));
    if (!is_known || !has_chain || !has_end) return "a pose without its chain";
    // A dropped pose hangs where the one before it on its chain does; so chains end at a kept pose.
    if (!seen.kept && (at == 0 || (*this)[seen.parent].base != seen.base)) return "a pose without its chain";
    if (seen.stretch != StretchAt(at)) return "a pose without its chain";
    if (at > 0) ++successors[At(seen.parent)];
  }
  for (int at = 0; at < Size(); ++at) {
    if ((*this)[at].successors != successors[At(at)]) return "a pose with another number of successors";
  }
  return "";
}

#define TERSE_INSTANTIATE(Pose)                             \
  template class PoseHistory<Pose>;                         \
  template void PoseHistory<Pose>::Serialize(StateWriter&); \
  template void PoseHistory<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
