#pragma once
// All poses seen, in order of arrival, and the chains of odometry by which the dropped ones hang on kept ones.
//
// A kept pose hangs on itself. A dropped one hangs on the kept pose that its chain starts from, its base; its chain
// comes from its parent: the pose that its odometry comes from, or the one that a link has anchored it to. A chain of
// dropped poses may end at a kept pose, with that one's odometry or with a link, and lies between the two from then on.
//
// What a chain measured counts once: chains are cut in stretches, from a kept pose or a link on, of which each is spent
// with the first loop of another pose that is carried along it.
//
// A place is a pose's number in order of arrival, from 0, among those that are remembered. Dropped poses can be
// forgotten (CompactOptions::most_dropped): those that no chain of a remembered one leads through.

#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "terse/compact/compact_map.h"
#include "terse/compact/uncertain_pose.h"

namespace terse::internal {

// A dropped pose as it comes back: between two kept poses, or, where the chain has not ended yet, on that of the pose
// at hand.
template <class Pose>
struct Revival {
  PoseId pose, base;
  UncertainPose<Pose> T_base_pose, T_pose_next;
  std::optional<PoseId> next;
  FactorId replaced;  // from base to next
  PoseId newest;      // the last pose of the chain
};

template <class Pose>
class PoseHistory {
 public:
  struct Seen {
    PoseId id, base;
    UncertainPose<Pose> T_base_pose;  // identity of a kept pose
    Pose T_world_body_when_seen;
    // Places of the poses that its odometry and its chain come from; the same, unless it is anchored. -1: the first.
    int previous = -1, parent = -1;
    int successors = 0;  // poses whose chain comes from it
    bool kept = true;
    bool anchored = false;
    // A dropped pose's chain as it ends at the next kept pose: with that one's odometry, or with a link of the pose at
    // the place `ended_by`, which was anchored.
    std::optional<PoseId> next_kept;
    UncertainPose<Pose> T_base_next;
    int ended_by = -1;
    int stretch = -1;      // the place where this one's starts; -1 of a kept pose
    bool carried = false;  // where a stretch starts: it is spent
    FactorId odometry;     // of a kept pose but the first: the factor that it came in with
  };
  using SeenPose = typename CompactMap<Pose>::SeenPose;

  int Size() const { return static_cast<int>(seen_.size()); }
  bool IsEmpty() const { return seen_.empty(); }
  bool Has(PoseId id) const { return index_.count(id.value) != 0; }
  long Forgotten() const { return forgotten_; }
  // Ids have ascended where anything was forgotten, so this is so of all between the first and the newest that are not
  // there, the ones that never came included.
  bool IsForgotten(PoseId id) const;
  // Both throw std::invalid_argument if the pose is unknown, or forgotten.
  int IndexOf(PoseId id) const;
  const Seen& Find(PoseId id) const { return (*this)[IndexOf(id)]; }
  const Seen& operator[](int place) const { return seen_[static_cast<std::size_t>(place)]; }
  PoseId Newest() const { return seen_.back().id; }
  PoseId NewerOf(PoseId a, PoseId b) const { return IndexOf(a) < IndexOf(b) ? b : a; }

  // The next pose, in all but its places.
  void Append(Seen seen, std::optional<PoseId> previous, std::optional<PoseId> parent);
  // The dropped poses of a chain up to `last`, but those whose chain has ended before, hang between their base and
  // `next` from now on; `by`: with a link of that pose, which is anchored.
  void EndChain(PoseId last, PoseId next, const UncertainPose<Pose>& T_base_next, std::optional<PoseId> by = {});
  void SetOdometry(PoseId kept, FactorId factor) { Mutable(kept).odometry = factor; }
  // Forgets dropped poses, if there are many more than these newest and ids have ascended. Amortised O(1) a pose.
  void Forget(int most_dropped);
  // The pose is kept, with this factor as its odometry. Those of its chain hang on the nearer of its parts.
  void Revive(const Revival<Pose>& revival, FactorId odometry);

  // Whether a chain leads from a dropped pose to `newest`, and nothing else hangs on it (other odometry that starts
  // from there hangs on the base too): on `newest` so many, on each of the others one.
  bool IsPlainChain(PoseId dropped, PoseId newest, int successors_of_newest) const;
  // The poses that the odometry of a kept pose was concatenated over, both ends included; empty for one measurement.
  std::vector<PoseId> ChainTo(PoseId kept) const;

  // Whether any stretch that a pose hangs on is spent; and spends all of them.
  bool IsSpent(PoseId id) const;
  void SpendChain(PoseId id);

  // The place of the last pose of a dropped one's chain, itself or before it, whose chain has ended at a kept pose:
  // both chains lead through it. -1 if there is none.
  int EndedBefore(PoseId id) const;
  // A chain that a link of the pose at place `by` has ended: a number behind all places. (That the same link starts the
  // chain of that pose is left out.) And the place of the last pose of the chain before one that ends there, or at a
  // place.
  int EndedByLink(int by) const { return Size() + by; }
  int ParentOnChain(int end) const;

  // As they are in a map, in order, but for their present places in the world; and from there, into an empty history.
  std::vector<SeenPose> Export() const;
  void Restore(const std::vector<SeenPose>& poses, long forgotten);

  template <class Archive>
  void Serialize(Archive& archive);
  // Of what was read: what contradicts itself or the kept graph, else "".
  std::string FindStateDefect(const PoseGraph<Pose>& kept) const;

 private:
  Seen& Mutable(int place) { return seen_[static_cast<std::size_t>(place)]; }
  Seen& Mutable(PoseId id) { return Mutable(IndexOf(id)); }
  int StretchAt(int place) const;
  int StretchBefore(int stretch) const;
  void LoseEnd(int place);
  void Erase(const std::vector<bool>& stays);

  // A parent comes before its pose, and a dropped pose has the base of its parent; so chains lead to kept poses. The
  // first pose is kept.
  std::vector<Seen> seen_;                       // by place
  std::unordered_map<std::int64_t, int> index_;  // the places, by id
  long forgotten_ = 0;
  int size_when_swept_ = 0;  // behind the last look for what to forget
  bool ascends_ = true;      // ids, so far
};

}  // namespace terse::internal
