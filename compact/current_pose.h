#pragma once
// The pose at hand while AddPose works it in, and the loops that came with it.

#include <optional>
#include <utility>
#include <vector>

#include "pose_history.h"
#include "terse/compact/compact_options.h"

namespace terse::internal {

// A loop that came measured with the pose at hand, or was registered for it.
template <class Pose>
struct Offer {
  RelativePoseFactor<Pose> measured;
  RelativePoseFactor<Pose> link;       // between the pose at hand and the kept pose that it was carried to
  UncertainPose<Pose> T_kept_current;  // the same
  PoseId kept;
  std::optional<PoseId> carried_from;
  typename Pose::Jacobian carried;  // what the chain adds to the loop's own covariance
  // From the dropped pose, if the pose at hand hangs on the same chain behind it.
  std::optional<UncertainPose<Pose>> T_dropped_current;
  bool registered = false;  // by the map's wish: it did not come with the pose

  PoseId MeasuredTo() const { return carried_from.value_or(kept); }
};

template <class Pose>
struct CurrentPose {
  const CompactInput<Pose>* input = nullptr;
  std::optional<PoseId> previous, parent;  // PoseHistory::Seen; absent for the first
  PoseId base;                             // the kept pose its chain hangs on; itself once it is in the solver
  UncertainPose<Pose> T_base_current;
  UncertainPose<Pose> chain;  // T_base_current as it came in, when base was still another pose
  Pose T_world_body;
  std::vector<Offer<Pose>> offers;
  std::vector<std::pair<PoseId, double>> in_range;  // kept poses, with the probability of it; for CompactBudget::error
  FactorId odometry;
  bool in_solver = false;
  bool concatenated = false;         // poses were dropped between base and this one
  bool is_anchored = false;          // its chain has started anew, with a link of its own
  UncertainPose<Pose> T_ended_base;  // if so: from the base of the chain before to that of this one
  std::optional<StepReport> update;  // all updates of the map so far

  // Odometry measures their displacement already.
  bool IsLinkedTo(PoseId id) const { return !concatenated && id == base; }
};

// A loop at the kept pose that its other end hangs on. Absent if it overflows on its way there, or if in a bounded map,
// where robots pass again and again and no measurement counts twice, its chain is spent.
template <class Pose>
std::optional<Offer<Pose>> TakeOffer(const RelativePoseFactor<Pose>& loop, const CurrentPose<Pose>& current,
                                     const PoseHistory<Pose>& history, const CompactOptions<Pose>& options);
// Those that came with the pose; how many lead to poses that are forgotten.
template <class Pose>
int TakeOffers(CurrentPose<Pose>& current, const PoseHistory<Pose>& history, const CompactOptions<Pose>& options);
// The loop is in the map: in a bounded one the chain that it was carried along is spent.
template <class Pose>
void Spend(const Offer<Pose>& offer, const CompactOptions<Pose>& options, PoseHistory<Pose>& history);

// What a loop that came with the pose tells if measured with Sigma_link, nats, `known` of T_kept_current. One that was
// carried counts only by what it tells of the map: a pose that is lost little by little always learns from it where it
// is, and a map that kept every such pose would grow for ever. About the kept poses the loop and the chain that the
// pose hangs on are one measurement, with the sum of their covariances.
template <class Pose>
double OfferGain(const Offer<Pose>& offer, const CurrentPose<Pose>& current, const UncertainPose<Pose>& known,
                 const typename Pose::Jacobian& Sigma_link);

}  // namespace terse::internal
