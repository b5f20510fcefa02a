// A map bounded by area (Strategy::kBounded): what a link says where the map is already.
//
// Two things. Where the robot is: the chain starts anew at the linked kept pose, with the link's covariance, and the
// pose is not kept. And what the map is like: from the pose's base along its chain and back along the link is a
// measurement between two kept poses, of which the map learns
//   1/2 ln |I + Sigma_d (Sigma_chain + Sigma_link)^-1|,
// Sigma_d what it knows of their displacement. It fuses with the edge that joins the two already, or becomes an edge if
// it tells enough. Every measurement is used once: the link that starts the next chain is none of those composed, and a
// stretch of a chain carries one loop of another pose at most, none if it is odometry between kept poses. This is the
// reduced pose graph of Johannsson et al. (ICRA 2013) with information as the judge. Where a link tells the map so much
// that a pose is worth it, as on the first return to old terrain, the pose is kept and linked as by Strategy::kFpfl.

#include <Eigen/Cholesky>
#include <algorithm>
#include <map>

#include "compact_pose_slam_parts.h"
#include "terse/compact/information.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

// Edges composed of two links of one pose, besides that of the chain.
constexpr int kMostPairs = 2;

template <class Jacobian>
double LogDeterminant(const Jacobian& covariance) {
  return 2 * covariance.llt().matrixLLT().diagonal().array().log().sum();
}

// Whether the chain that a dropped pose hangs on is odometry of the map. A loop that came along it would count that a
// second time, and a map of many such loops would be too sure of itself.
template <class Seen>
bool IsOnOdometry(const Seen& dropped) {
  return dropped.next_kept && dropped.ended_by < 0;
}

// As a measurement of the optimiser.
template <class Pose>
UncertainPose<Pose> Composed(const UncertainPose<Pose>& ab, const UncertainPose<Pose>& bc, CompositionOrder order) {
  UncertainPose<Pose> ac = Compose(ab, bc, order);
  if (order != CompositionOrder::kFirst) ac.covariance = RetractCovariance(ac);
  return ac;
}

// The pose that a loop of the pose at hand leads to, kept or not.
template <class Offer>
PoseId MeasuredTo(const Offer& loop) {
  return loop.carried_from.value_or(loop.kept);
}

}  // namespace

template <class Pose>
double CompactPoseSlam<Pose>::MapGain(const Current& current, const UncertainPose<Pose>& known,
                                      const Jacobian& Sigma_link) const {
  const Jacobian& chain = current.T_base_current.covariance;
  return InformationGain<Pose::kDof>(known.covariance - chain, Sigma_link + chain);
}

// Of the loops to each kept pose the most precise, and none that was carried along odometry of the map if there is
// another. Those along the pose's own chain go.
template <class Pose>
void CompactPoseSlam<Pose>::ThinOffers(Current& current) const {
  std::map<PoseId, Offer> best;
  const auto is_on_odometry = [&](const Offer& offer) {
    return offer.carried_from && IsOnOdometry(Find(*offer.carried_from));
  };
  const auto is_better = [&](const Offer& a, const Offer& b) {
    const bool a_counts_twice = is_on_odometry(a), b_counts_twice = is_on_odometry(b);
    if (a_counts_twice != b_counts_twice) return b_counts_twice;
    return LogDeterminant(a.T_kept_current.covariance) < LogDeterminant(b.T_kept_current.covariance);
  };
  for (Offer& offer : current.offers) {
    const bool is_own_chain = offer.kept == current.base && (offer.carried_from || !current.concatenated);
    if (is_own_chain) continue;
    const auto it = best.find(offer.kept);
    if (it == best.end()) {
      best.emplace(offer.kept, std::move(offer));
    } else if (is_better(offer, it->second)) {
      it->second = std::move(offer);
    }
  }
  current.offers.clear();
  for (auto& [kept, offer] : best) current.offers.push_back(std::move(offer));
}

// A loop of the pose at hand, in Current::offers, if it agrees with the map.
template <class Pose>
void CompactPoseSlam<Pose>::Sight(const Current& current, int offer, Decision& decision,
                                  std::vector<Evaluated>& candidates, std::vector<Sighting>& sightings) {
  const Offer& loop = current.offers[At(offer)];
  const int pose = solver_->Graph().IndexOf(loop.kept);
  Evaluated e = Evaluate(current, {{pose, offer}}, true).front();
  e.record.measured_gain = InformationGain<Pose::kDof>(e.T_pose_current.covariance, loop.T_kept_current.covariance);
  const bool good = IsBelieved(e.plausible ? &current : nullptr, e.T_pose_current, loop.T_kept_current, e.record);
  LogLink(e.record.id, current.input->id, e.record, good);
  if (IsRefused(e.record)) ++decision.links_refused;
  if (good) {
    Sighting sighting;
    sighting.offer = offer;
    sighting.log_det = LogDeterminant(loop.T_kept_current.covariance);
    if (loop.kept != current.base) {
      sighting.map_gain = MapGain(current, e.T_pose_current, loop.T_kept_current.covariance);
    }
    sightings.push_back(sighting);
  }
  candidates.push_back(std::move(e));
}

// Registers what promises most, until the robot is found again, and once more if the map would learn from the two.
// Those tried are marked.
template <class Pose>
void CompactPoseSlam<Pose>::RegisterSightings(Current& current, Decision& decision,
                                              const Registration<Pose>& registration,
                                              std::vector<Evaluated>& candidates, std::vector<Sighting>& sightings) {
  const std::vector<Failed> before = FailedNear(current);
  std::vector<Failed> failed = before;
  const bool is_linked = !current.concatenated;
  while (decision.registrations_tried < options_.max_registrations && sightings.size() < 2) {
    if (!sightings.empty() && sightings.front().map_gain > gains_->MinLoopGain()) return;
    Evaluated* best = nullptr;
    for (Evaluated& e : candidates) {
      if (e.ask.offer >= 0 || e.record.tried || e.record.gain <= gains_->MinLoopGain()) continue;
      if ((is_linked && e.record.id == current.base) || IsNearFailed(failed, e.record.id)) continue;
      const bool is_second = !sightings.empty();
      if (is_second &&
          (e.record.id == current.base || MapGain(current, e.T_pose_current, options_.thresholds.link_covariance) <=
                                              LeastEdgeGain(current.base, e.record.id))) {
        continue;
      }
      if (best == nullptr || e.worth > best->worth) best = &e;
    }
    if (best == nullptr) return;
    best->record.tried = true;
    ++decision.registrations_tried;
    const PoseId id = best->record.id;
    const auto link = Register(registration, id, current.input->id);
    Offer offer;
    if (!link || !TakeOffer(current, *link, offer)) {
      failed.push_back({id, current.input->id});
      failed_.push_back(failed.back());
      continue;
    }
    // From here on it is a loop that came with the pose.
    const auto is_same = [&](const Evaluated& e) { return e.ask.offer < 0 && e.record.id == id; };
    candidates.erase(std::find_if(candidates.begin(), candidates.end(), is_same));
    current.offers.push_back(std::move(offer));
    Sight(current, static_cast<int>(current.offers.size()) - 1, decision, candidates, sightings);
    candidates.back().record.tried = true;
  }
}

template <class Pose>
void CompactPoseSlam<Pose>::Bound(Current& current, Decision& decision, const Registration<Pose>& registration) {
  const bool registers = registration != nullptr && !current.input->loops;
  std::vector<Evaluated> candidates;
  std::vector<Sighting> sightings;
  const auto search = [&] {
    for (Evaluated& e : Evaluate(current, InReach(current, registers), registers)) {
      if (e.record.probability > options_.thresholds.probability) {
        if (registers && options_.budget.error) current.in_range.emplace_back(e.record.id, e.record.probability);
        decision.pose_gain = std::min(decision.pose_gain.value_or(e.record.gain), e.record.gain);
      }
      if (registers) candidates.push_back(std::move(e));
    }
  };
  searches_ = true;
  UpdateCovariances();
  ThinOffers(current);
  // What is known of the linked poses is worked out for them alone, to the same bits whether a search came before.
  if (!current.offers.empty()) searched_base_ = -1;
  for (size_t k = 0; k < current.offers.size(); ++k) {
    Sight(current, static_cast<int>(k), decision, candidates, sightings);
  }
  if (registers) {
    search();
    RegisterSightings(current, decision, registration, candidates, sightings);
  }
  const bool is_kept = current.input->fixed || !current.input->priors.empty();
  const bool tells_map = std::any_of(sightings.begin(), sightings.end(),
                                     [&](const Sighting& s) { return s.map_gain > gains_->MinLoopGain(); });
  if (is_kept || tells_map) {
    if (!registers) search();
    for (Evaluated& e : candidates) {
      if (e.ask.offer >= 0) e.record.tried = IsRefused(e.record);
    }
    CloseLoops(current, candidates, decision, registers ? registration : nullptr);
    if (current.in_solver || is_kept) return;
    decision.candidates.clear();  // the map has no solution with them; they may still say where the robot is
  }
  Anchor(current, decision, candidates, std::move(sightings));
  if (!current.is_anchored && !registers) search();
  std::vector<Candidate> settled;
  settled.reserve(candidates.size());
  for (Evaluated& e : candidates) settled.push_back(std::move(e.record));
  RecordCandidates(std::move(settled), options_, decision);
}

// The most precise link starts the chain anew, if it knows the pose better than the chain does. Of the others one ends
// the old chain in an edge between kept poses, and the rest make edges two by two.
template <class Pose>
void CompactPoseSlam<Pose>::Anchor(Current& current, Decision& decision, std::vector<Evaluated>& candidates,
                                   std::vector<Sighting> sightings) {
  const auto is_carried_on_odometry = [&](const Sighting& s) {
    const auto& dropped = current.offers[At(s.offer)].carried_from;
    return dropped && IsOnOdometry(Find(*dropped));
  };
  sightings.erase(std::remove_if(sightings.begin(), sightings.end(), is_carried_on_odometry), sightings.end());
  if (sightings.empty()) return;
  std::stable_sort(sightings.begin(), sightings.end(),
                   [](const Sighting& a, const Sighting& b) { return a.log_det < b.log_det; });
  if (!(sightings.front().log_det < LogDeterminant(current.T_base_current.covariance))) return;
  const Sighting anchor = sightings.front();
  sightings.erase(sightings.begin());
  std::vector<NewEdge> edges = ComposeEdges(current, std::move(sightings));
  const auto use = [&](int offer) -> Candidate& {
    Spend(current.offers[At(offer)]);
    Candidate& record = std::find_if(candidates.begin(), candidates.end(), [&](const Evaluated& e) {
                          return e.ask.offer == offer;
                        })->record;
    record.tried = true;
    return record;
  };
  try {
    if (!edges.empty()) AddEdges(current.input->id, edges, decision, current.update);
  } catch (const NumericalError& error) {
    edges.clear();
    internal::Log(options_.log, LogLevel::kInfo, "edges composed at pose ", current.input->id.value,
                  " left out: ", error.what());
  }
  for (const NewEdge& edge : edges) {
    if (edge.offers.size() == 1) SpendChain(current.previous);
    for (const int offer : edge.offers) use(offer).composed = true;
  }
  const Offer& link = current.offers[At(anchor.offer)];
  use(anchor.offer).anchors = true;
  decision.anchored_to = link.kept;
  current.is_anchored = true;
  current.T_ended_base = Compose(current.T_base_current, Invert(link.T_kept_current), options_.composition);
  current.base = link.kept;
  current.T_base_current = link.T_kept_current;
  current.parent = index_.at(link.carried_from.value_or(link.kept).value);
  current.T_world_body = solver_->Estimate(current.base) * current.T_base_current.T_a_b;
}

// Those worth it, of the chain and of pairs of links; none uses what another does.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::NewEdge> CompactPoseSlam<Pose>::ComposeEdges(
    const Current& current, std::vector<Sighting> sightings) const {
  std::vector<NewEdge> edges;
  const Sighting* end = nullptr;
  for (const Sighting& s : sightings) {
    const PoseId kept = current.offers[At(s.offer)].kept;
    if (kept == current.base || s.map_gain <= LeastEdgeGain(current.base, kept)) continue;
    if (end == nullptr || s.map_gain > end->map_gain) end = &s;
  }
  if (end != nullptr) {
    const Offer& link = current.offers[At(end->offer)];
    edges.push_back({current.base,
                     link.kept,
                     Composed(current.T_base_current, Invert(link.T_kept_current), options_.composition),
                     end->map_gain,
                     {end->offer},
                     {MeasuredTo(link)}});
    sightings.erase(sightings.begin() + (end - sightings.data()));
  }
  for (int pairs = 0; pairs < kMostPairs && sightings.size() >= 2; ++pairs) {
    std::optional<NewEdge> best;
    std::pair<size_t, size_t> at;
    for (size_t a = 0; a < sightings.size(); ++a) {
      for (size_t b = a + 1; b < sightings.size(); ++b) {
        const Offer &from = current.offers[At(sightings[a].offer)], &to = current.offers[At(sightings[b].offer)];
        NewEdge edge{from.kept,
                     to.kept,
                     Composed(from.T_kept_current, Invert(to.T_kept_current), options_.composition),
                     0,
                     {sightings[a].offer, sightings[b].offer},
                     {MeasuredTo(from), MeasuredTo(to)}};
        edge.gain = InformationGain<Pose::kDof>(Between(from.kept, to.kept).covariance, edge.T_a_b.covariance);
        if (edge.gain <= LeastEdgeGain(from.kept, to.kept) || (best && edge.gain <= best->gain)) continue;
        best = std::move(edge);
        at = {a, b};
      }
    }
    if (!best) break;
    edges.push_back(std::move(*best));
    sightings.erase(sightings.begin() + static_cast<long>(at.second));
    sightings.erase(sightings.begin() + static_cast<long>(at.first));
  }
  return edges;
}

#define TERSE_INSTANTIATE(Pose)                                                                                      \
  template double CompactPoseSlam<Pose>::MapGain(const Current&, const UncertainPose<Pose>&, const Jacobian&) const; \
  template void CompactPoseSlam<Pose>::ThinOffers(Current&) const;                                                   \
  template void CompactPoseSlam<Pose>::Sight(const Current&, int, Decision&, std::vector<Evaluated>&,                \
                                             std::vector<Sighting>&);                                                \
  template void CompactPoseSlam<Pose>::RegisterSightings(Current&, Decision&, const Registration<Pose>&,             \
                                                         std::vector<Evaluated>&, std::vector<Sighting>&);           \
  template void CompactPoseSlam<Pose>::Anchor(Current&, Decision&, std::vector<Evaluated>&, std::vector<Sighting>);  \
  template std::vector<CompactPoseSlam<Pose>::NewEdge> CompactPoseSlam<Pose>::ComposeEdges(                          \
      const Current&, std::vector<Sighting>) const;                                                                  \
  template void CompactPoseSlam<Pose>::Bound(Current&, Decision&, const Registration<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
