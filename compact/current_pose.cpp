#include "current_pose.h"

#include "carry.h"
#include "chains.h"
#include "terse/compact/information.h"

namespace terse::internal {

template <class Pose>
std::optional<Offer<Pose>> TakeOffer(const RelativePoseFactor<Pose>& loop, const CurrentPose<Pose>& current,
                                     const PoseHistory<Pose>& history, const CompactOptions<Pose>& options) {
  const PoseId other = loop.from == current.input->id ? loop.to : loop.from;
  Offer<Pose> offer;
  offer.measured = loop;
  offer.link = CarryEndToKept(other, loop, history, options.composition);
  if (!FindDefect<Pose>(offer.link).empty()) return std::nullopt;
  const auto& seen = history.Find(other);
  offer.kept = seen.base;
  if (!seen.kept) offer.carried_from = other;
  if (!seen.kept && options.strategy == Strategy::kBounded && history.IsSpent(other)) return std::nullopt;
  offer.T_kept_current = SeenFrom(offer.kept, offer.link);
  offer.carried = offer.T_kept_current.covariance - SeenFrom(other, loop).covariance;
  if (!seen.kept && !current.in_solver && offer.kept == current.base && !seen.next_kept &&
      history.IsPlainChain(other, *current.parent, 0)) {
    offer.T_dropped_current = Behind(seen.T_base_pose, current.T_base_current);
  }
  return offer;
}

template <class Pose>
int TakeOffers(CurrentPose<Pose>& current, const PoseHistory<Pose>& history, const CompactOptions<Pose>& options) {
  int forgotten = 0;
  if (!current.input->loops) return forgotten;
  for (const RelativePoseFactor<Pose>& loop : *current.input->loops) {
    if (history.IsForgotten(loop.from) || history.IsForgotten(loop.to)) {
      ++forgotten;
    } else if (auto offer = TakeOffer(loop, current, history, options)) {
      current.offers.push_back(std::move(*offer));
    }
  }
  return forgotten;
}

template <class Pose>
void Spend(const Offer<Pose>& offer, const CompactOptions<Pose>& options, PoseHistory<Pose>& history) {
  if (offer.carried_from && options.strategy == Strategy::kBounded) history.SpendChain(*offer.carried_from);
}

template <class Pose>
double OfferGain(const Offer<Pose>& offer, const CurrentPose<Pose>& current, const UncertainPose<Pose>& known,
                 const typename Pose::Jacobian& Sigma_link) {
  using Jacobian = typename Pose::Jacobian;
  if (offer.T_dropped_current) {
    return InformationGain<Pose::kDof>(offer.T_dropped_current->covariance, Sigma_link);
  }
  if (!offer.carried_from) return InformationGain<Pose::kDof>(known.covariance, Sigma_link);
  const Jacobian Sigma_y = Sigma_link + offer.carried;
  if (current.in_solver) return InformationGain<Pose::kDof>(known.covariance, Sigma_y);
  const Jacobian of_map = known.covariance - current.T_base_current.covariance;
  return InformationGain<Pose::kDof>(of_map, Sigma_y + current.T_base_current.covariance);
}

#define TERSE_INSTANTIATE(Pose)                                                                            \
  template std::optional<Offer<Pose>> TakeOffer(const RelativePoseFactor<Pose>&, const CurrentPose<Pose>&, \
                                                const PoseHistory<Pose>&, const CompactOptions<Pose>&);    \
  template int TakeOffers(CurrentPose<Pose>&, const PoseHistory<Pose>&, const CompactOptions<Pose>&);      \
  template void Spend(const Offer<Pose>&, const CompactOptions<Pose>&, PoseHistory<Pose>&);                \
  template double OfferGain(const Offer<Pose>&, const CurrentPose<Pose>&, const UncertainPose<Pose>&,      \
                            const typename Pose::Jacobian&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
