#pragma once
// Links that disagree with the map: refused, unless enough of them agree with each other. Then it is the map that is
// off, as after odometry that was worse than its covariance says. And registrations that failed: their neighbours are
// not tried at once.

#include <string>
#include <vector>

#include "current_pose.h"
#include "kept_map.h"
#include "terse/compact/decision.h"
#include "terse/core/cycle_test.h"
#include "terse/core/innovation_scale.h"

namespace terse::internal {

// Refused for its innovation, and no others agree with it.
inline bool IsRefused(const Candidate& link) { return link.outlier && !link.supported; }

template <class Pose>
class LinkTests {
 public:
  using Refused = typename CompactMap<Pose>::Refused;
  using Failed = typename CompactMap<Pose>::Failed;

  // All outlive it.
  LinkTests(const CompactOptions<Pose>& options, const KeptMap<Pose>& map, const PoseHistory<Pose>& history)
      : options_(options), map_(map), history_(history) {}
  // The options have changed.
  void TakeOptions();
  // The limit: that of the quantile, or lower where links agree much better than their covariances say
  // (innovation_scale.h, cycle_test.h). Infinite without the test.
  double MostInnovation() const { return most_innovation_; }

  // The pose at hand, before its links are asked for.
  void NoteOdometry(const CompactInput<Pose>& input);
  // Whether a registered link agrees with the map, and with odometry alone: between record.id and the pose at hand, or
  // two poses seen before (`current` absent). An outlier may be supported by other links of the pose at hand; if it is
  // not, it may support a later one.
  bool IsBelieved(const CurrentPose<Pose>* current, const UncertainPose<Pose>& known,
                  const UncertainPose<Pose>& measured, Candidate& record);

  void NoteFailed(const Failed& registration) { failed_.push_back(registration); }
  // Registrations that failed where the pose at hand is. Those of an earlier visit count as well, as far as the map
  // knows that it is the same place.
  std::vector<Failed> FailedNear(const CurrentPose<Pose>& current) const;
  bool IsNearFailed(const std::vector<Failed>& failed, PoseId candidate) const;

  // After a pose: its innovations count, as many links as are kept stay, and none of poses that are forgotten. And
  // nothing stays of a pose that did not come in.
  void TakeIn();
  void ForgetNewest(PoseId seen);

  void Export(CompactMap<Pose>& map) const;
  void Restore(const CompactMap<Pose>& map);
  template <class Archive>
  void Serialize(Archive& archive);
  // Of what was read: what contradicts the kept graph or what was seen, else "".
  std::string FindStateDefect() const;

 private:
  struct Agreed {
    PoseId candidate, seen;
  };
  bool IsOutvoted(PoseId candidate, PoseId current, PoseId first_supporter, long supporters) const;
  void ClearNoted();
  template <class Test>
  void EraseIf(const Test& test);  // of PoseId `seen`
  UncertainPose<Pose> FromSeen(PoseId id, const CurrentPose<Pose>& current) const;
  bool IsSupported(const CurrentPose<Pose>& current, PoseId candidate, const UncertainPose<Pose>& known,
                   const UncertainPose<Pose>& measured) const;
  bool AreNeighbours(const Pose& T_world_a, const Pose& T_world_b) const;

  const CompactOptions<Pose>& options_;
  const KeptMap<Pose>& map_;
  const PoseHistory<Pose>& history_;
  double stated_innovation_ = 0, most_innovation_ = 0;  // the limit of the quantile, and as it is
  InnovationScale scale_;
  CycleTest<Pose> cycles_;
  PoseId newest_before_;  // cycles_
  // Innovations, and links that agree, of the pose at hand: they count when it is in. Else empty.
  std::vector<double> noted_, noted_cycles_;
  bool noted_break_ = false;  // links agree that odometry has failed
  std::vector<Agreed> noted_agreed_;
  std::vector<Agreed> agreed_;  // the last ones, oldest first
  // The last ones, oldest first: candidates are kept poses, those at which they were tried seen ones.
  std::vector<Refused> refused_;
  std::vector<Failed> failed_;
};

}  // namespace terse::internal
