// Links that disagree with the map: refused, unless enough of them agree with each other. Then it is the map that is
// off, as after odometry that was worse than its covariance says.

#include <set>

#include "compact_pose_slam_parts.h"
#include "terse/compact/information.h"
#include "terse/compact/innovation.h"

namespace terse {
namespace {

using internal::Behind;

// A prediction that knows much less than the link measures agrees with anything: nats per degree of freedom.
constexpr double kMostVagueness = 1;

}  // namespace

// T_a_b between kept poses, from the map.
template <class Pose>
UncertainPose<Pose> CompactPoseSlam<Pose>::Between(PoseId a, PoseId b) const {
  if (a == b) return {};
  return {solver_->Estimate(a).Inverse() * solver_->Estimate(b), marginals_->Relative(a, b)};
}

// From a pose seen before to the one at hand, along its chain or through the map, whichever knows more.
template <class Pose>
UncertainPose<Pose> CompactPoseSlam<Pose>::FromSeen(PoseId id, const Current& current) const {
  const auto& seen = history_->Find(id);
  if (!seen.kept && !seen.next_kept && seen.base == current.base) {
    // Both hang on one chain: what lies before the older one is no error between them.
    if (const auto behind = Behind(seen.T_base_pose, current.T_base_current)) return *behind;
  }
  UncertainPose<Pose> best = Compose(Invert(seen.T_base_pose), Between(seen.base, current.base));
  if (!seen.kept && seen.next_kept) {
    if (const auto behind = Behind(seen.T_base_pose, seen.T_base_next)) {
      const UncertainPose<Pose> through_next = Compose(*behind, Between(*seen.next_kept, current.base));
      if (through_next.covariance.determinant() < best.covariance.determinant()) best = through_next;
    }
  }
  return Compose(best, current.T_base_current);
}

// Whether enough refused links of other poses predict this one of the pose at hand.
template <class Pose>
bool CompactPoseSlam<Pose>::IsSupported(const Current& current, PoseId candidate,
                                        const UncertainPose<Pose>& measured) const {
  std::set<PoseId> supporters;
  for (auto it = refused_.rbegin(); it != refused_.rend(); ++it) {
    if (it->seen == current.input->id || supporters.count(it->seen) != 0) continue;
    const UncertainPose<Pose> T_candidate_seen = Compose(Between(candidate, it->candidate), it->T_candidate_seen);
    const UncertainPose<Pose> predicted = Compose(T_candidate_seen, FromSeen(it->seen, current));
    const double vagueness = InformationGain<Pose::kDof>(predicted.covariance, measured.covariance);
    if (vagueness > kMostVagueness * Pose::kDof) continue;
    if (InnovationDistance(predicted, measured) > most_innovation_) continue;
    supporters.insert(it->seen);
    if (static_cast<int>(supporters.size()) + 1 >= options_.consensus) return true;
  }
  return false;
}

template <class Pose>
void CompactPoseSlam<Pose>::RememberRefused(const Current& current, PoseId candidate,
                                            const UncertainPose<Pose>& measured) {
  refused_.push_back({candidate, current.input->id, measured});
}

#define TERSE_INSTANTIATE(Pose)                                                                               \
  template UncertainPose<Pose> CompactPoseSlam<Pose>::Between(PoseId, PoseId) const;                          \
  template UncertainPose<Pose> CompactPoseSlam<Pose>::FromSeen(PoseId, const Current&) const;                 \
  template bool CompactPoseSlam<Pose>::IsSupported(const Current&, PoseId, const UncertainPose<Pose>&) const; \
  template void CompactPoseSlam<Pose>::RememberRefused(const Current&, PoseId, const UncertainPose<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
