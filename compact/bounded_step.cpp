#include "bounded_step.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <map>

#include "loop_closing.h"
#include "terse/compact/information.h"
#include "terse/compact/log_determinant.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse::internal {
namespace {

using std::size_t;

// Edges composed of two links of one pose, besides that of the chain.
constexpr int kMostPairs = 2;
// Of min_loop_gain: what a chain may still tell the map that is lost because a link starts it anew. Where more is lost,
// small as it is each time, the map comes apart into a tree (sphere2500, a loop per pose: 3.9 m off instead of 0.4).
// Where there was another link to end the chain in an edge, as much may be lost as that edge would have had to tell.
constexpr double kMostLost = 0.5;

// T_a_c as a measurement of the optimiser, from T_a_b and T_c_b.
template <class Pose>
UncertainPose<Pose> ComposeBack(const UncertainPose<Pose>& ab, const UncertainPose<Pose>& cb, CompositionOrder order) {
  UncertainPose<Pose> ac = Compose(ab, Invert(cb), order);
  if (order != CompositionOrder::kFirst) ac.covariance = RetractCovariance(ac);
  return ac;
}

}  // namespace

template <class Pose>
void BoundedStep<Pose>::Run() {
  const bool registers = Registers();
  parts_.map.KeepCovariances(true);
  parts_.map.UpdateCovariances();
  ThinOffers();
  // What is known of the linked poses is worked out for them alone, to the same bits whether a search came before.
  if (!current_.offers.empty()) parts_.search.Forget();
  for (size_t k = 0; k < current_.offers.size(); ++k) Sight(static_cast<int>(k));
  if (registers) {
    Search();
    RegisterSightings();
  }
  const bool is_kept = current_.input->fixed || !current_.input->priors.empty();
  if (is_kept || TellsMap()) {
    if (!registers) Search();
    for (Evaluated<Pose>& e : candidates_) {
      if (e.ask.offer >= 0) e.record.tried = IsRefused(e.record);
    }
    LoopClosing<Pose>(current_, decision_, registration_, parts_).CloseLoops(candidates_);
    if (current_.in_solver || is_kept) return;
    decision_.candidates.clear();  // the map has no solution with them; they may still say where the robot is
  }
  Anchor();
  if (!current_.is_anchored && !registers) Search();
  std::vector<Candidate> settled;
  settled.reserve(candidates_.size());
  for (Evaluated<Pose>& e : candidates_) settled.push_back(std::move(e.record));
  RecordCandidates(std::move(settled), parts_.options, decision_);
}

// Whether the chain that the loop was carried along is odometry of the map. A loop that came along it would count that
// a second time, and a map of many such loops would be too sure of itself.
template <class Pose>
bool BoundedStep<Pose>::IsOnOdometry(const Offer<Pose>& offer) const {
  if (!offer.carried_from) return false;
  const auto& dropped = parts_.history.Find(*offer.carried_from);
  return dropped.next_kept && dropped.ended_by < 0;
}

template <class Pose>
double BoundedStep<Pose>::MapGain(const UncertainPose<Pose>& known, const Jacobian& Sigma_link) const {
  const Jacobian& chain = current_.T_base_current.covariance;
  return InformationGain<Pose::kDof>(known.covariance - chain, Sigma_link + chain);
}

// Whether a link to a kept pose may end the chain in an edge, by what it tells of the map with the chain, nats.
template <class Pose>
bool BoundedStep<Pose>::TellsEnough(PoseId kept, double map_gain) const {
  return kept != current_.base && map_gain > LeastEdgeGain(current_.base, kept, parts_);
}

// Of the loops to each kept pose the most precise, and none that was carried along odometry of the map if there is
// another. Those along the pose's own chain go.
template <class Pose>
void BoundedStep<Pose>::ThinOffers() {
  std::map<PoseId, Offer<Pose>> best;
  const auto is_better = [&](const Offer<Pose>& a, const Offer<Pose>& b) {
    const bool a_counts_twice = IsOnOdometry(a), b_counts_twice = IsOnOdometry(b);
    if (a_counts_twice != b_counts_twice) return b_counts_twice;
    return LogDeterminant(a.T_kept_current.covariance) < LogDeterminant(b.T_kept_current.covariance);
  };
  for (Offer<Pose>& offer : current_.offers) {
    const bool is_own_chain = offer.kept == current_.base && (offer.carried_from || !current_.concatenated);
    if (is_own_chain) continue;
    const auto it = best.find(offer.kept);
    if (it == best.end()) {
      best.emplace(offer.kept, std::move(offer));
    } else if (is_better(offer, it->second)) {
      it->second = std::move(offer);
    }
  }
  current_.offers.clear();
  for (auto& [kept, offer] : best) current_.offers.push_back(std::move(offer));
}

// What the pose may tell, and, where it may be registered, the candidates.
template <class Pose>
void BoundedStep<Pose>::Search() {
  const bool registers = Registers();
  for (Evaluated<Pose>& e : parts_.search.Evaluate(current_, parts_.search.InReach(current_, registers), registers)) {
    NotePoseGain(e.record, registers, parts_.options, current_, decision_);
    if (registers) candidates_.push_back(std::move(e));
  }
}

// A loop of the pose, in CurrentPose::offers, becomes a candidate, and a sighting if it agrees with the map.
template <class Pose>
void BoundedStep<Pose>::Sight(int offer) {
  const Offer<Pose>& loop = current_.offers[At(offer)];
  Evaluated<Pose> e = parts_.search.EvaluateOffer(current_, offer);
  e.record.measured_gain = InformationGain<Pose::kDof>(e.T_pose_current.covariance, loop.T_kept_current.covariance);
  const bool good =
      parts_.tests.IsBelieved(e.plausible ? &current_ : nullptr, e.T_pose_current, loop.T_kept_current, e.record);
  LogLink(e.record.id, current_.input->id, e.record, good, parts_, "agrees with the map");
  if (IsRefused(e.record)) ++decision_.links_refused;
  if (good) {
    Sighting sighting;
    sighting.offer = offer;
    sighting.log_det = LogDeterminant(loop.T_kept_current.covariance);
    sighting.is_doubted = e.record.outlier;
    if (loop.kept != current_.base) sighting.map_gain = MapGain(e.T_pose_current, loop.T_kept_current.covariance);
    sightings_.push_back(sighting);
  }
  candidates_.push_back(std::move(e));
}

// Registers what promises most, until the robot is found again, and once more if the map would learn from the two.
// Those tried are marked.
template <class Pose>
void BoundedStep<Pose>::RegisterSightings() {
  std::vector<Failed> failed = parts_.tests.FailedNear(current_);
  while (decision_.registrations_tried < parts_.options.max_registrations && sightings_.size() < 2) {
    if (!sightings_.empty() && sightings_.front().map_gain > parts_.gains.MinLoopGain()) return;
    Evaluated<Pose>* best = NextToRegister(failed);
    if (best == nullptr) return;
    best->record.tried = true;
    ++decision_.registrations_tried;
    const PoseId id = best->record.id;
    const auto link = Register(registration_, id, current_.input->id);
    auto offer = link ? TakeOffer(*link, current_, parts_.history, parts_.options) : std::nullopt;
    if (!offer) {
      failed.push_back({id, current_.input->id});
      parts_.tests.NoteFailed(failed.back());
      continue;
    }
    // From here on it is like a loop that came with the pose.
    offer->registered = true;
    const auto is_same = [&](const Evaluated<Pose>& e) { return e.ask.offer < 0 && e.record.id == id; };
    candidates_.erase(std::find_if(candidates_.begin(), candidates_.end(), is_same));
    current_.offers.push_back(std::move(*offer));
    Sight(static_cast<int>(current_.offers.size()) - 1);
    candidates_.back().record.tried = true;
  }
}

// A second one only if the map would learn from the two: from an edge of one, while the other starts the chain anew.
// nullptr if there is none.
template <class Pose>
Evaluated<Pose>* BoundedStep<Pose>::NextToRegister(const std::vector<Failed>& failed) {
  const bool first_tells =
      !sightings_.empty() && TellsEnough(OfferOf(sightings_.front()).kept, sightings_.front().map_gain);
  const auto tells = [&](const Evaluated<Pose>& e) {
    if (sightings_.empty()) return e.record.gain > parts_.gains.MinLoopGain();
    return first_tells ||
           TellsEnough(e.record.id, MapGain(e.T_pose_current, parts_.options.thresholds.link_covariance));
  };
  Evaluated<Pose>* best = nullptr;
  for (Evaluated<Pose>& e : candidates_) {
    if (e.ask.offer >= 0 || e.record.tried || !tells(e)) continue;
    if (current_.IsLinkedTo(e.record.id) || parts_.tests.IsNearFailed(failed, e.record.id)) continue;
    if (best == nullptr || e.worth > best->worth) best = &e;
  }
  return best;
}

// Whether a pose is worth it.
template <class Pose>
bool BoundedStep<Pose>::TellsMap() const {
  return std::any_of(sightings_.begin(), sightings_.end(), [&](const Sighting& s) {
    const Offer<Pose>& link = OfferOf(s);
    return s.map_gain > parts_.gains.MinLoopGain() && LowersVariance(current_, link.kept, link.T_kept_current, parts_);
  });
}

template <class Pose>
void BoundedStep<Pose>::Use(int offer, bool Candidate::*as) {
  Spend(current_.offers[At(offer)], parts_.options, parts_.history);
  Candidate& record = std::find_if(candidates_.begin(), candidates_.end(), [&](const Evaluated<Pose>& e) {
                        return e.ask.offer == offer;
                      })->record;
  record.tried = true;
  record.*as = true;
}

// A second link was registered so that what the first tells is not lost: the one that tells more ends the chain in an
// edge, if it may, however precise it is.
template <class Pose>
void BoundedStep<Pose>::PutSecondToUse(std::vector<Sighting>& sightings) const {
  if (sightings.size() != 2 || !(sightings.front().map_gain > sightings.back().map_gain)) return;
  if (TellsEnough(OfferOf(sightings.front()).kept, sightings.front().map_gain)) std::swap(sightings[0], sightings[1]);
}

// The most precise link starts the chain anew, if it knows the pose better than the chain does and with that the map
// loses little: best one of those that alone would lose little. Of the others one ends the old chain in an edge between
// kept poses, and the rest make edges two by two.
template <class Pose>
void BoundedStep<Pose>::Anchor() {
  std::vector<Sighting> sightings = sightings_;
  // What the kernel is to judge has to stay a loop: a chain that starts anew at a wrong place does so for good.
  const bool judges = parts_.options.solver.robust.kernel == RobustKernel::kGnc;
  const auto is_no_use = [&](const Sighting& s) { return IsOnOdometry(OfferOf(s)) || (judges && s.is_doubted); };
  sightings.erase(std::remove_if(sightings.begin(), sightings.end(), is_no_use), sightings.end());
  if (sightings.empty()) return;
  std::stable_sort(sightings.begin(), sightings.end(),
                   [](const Sighting& a, const Sighting& b) { return a.log_det < b.log_det; });
  const double most_lost = sightings.size() > 1 ? parts_.gains.MinEdgeGain() : kMostLost * parts_.gains.MinLoopGain();
  const auto loses_much = [&](const Sighting& s) { return s.map_gain > most_lost; };
  if (Registers()) PutSecondToUse(sightings);
  auto best = std::find_if_not(sightings.begin(), sightings.end(), loses_much);
  if (best == sightings.end()) best = sightings.begin();
  if (!(best->log_det < LogDeterminant(current_.T_base_current.covariance))) return;
  const Sighting anchor = *best;
  sightings.erase(best);
  std::vector<NewEdge<Pose>> edges = ComposeEdges(std::move(sightings));
  const auto ends_chain = [](const NewEdge<Pose>& edge) { return edge.offers.size() == 1; };
  if (loses_much(anchor) && std::none_of(edges.begin(), edges.end(), ends_chain)) return;
  try {
    if (!edges.empty()) AddEdges(current_.input->id, edges, parts_, current_.update);
  } catch (const NumericalError& error) {
    edges.clear();
    Log(parts_.options.log, LogLevel::kInfo, "edges composed at pose ", current_.input->id.value,
        " left out: ", error.what());
  }
  for (const NewEdge<Pose>& edge : edges) {
    decision_.edges.push_back({edge.id, edge.a, edge.b, edge.gain, edge.fused});
    if (edge.offers.size() == 1) parts_.history.SpendChain(*current_.previous);
    for (const int offer : edge.offers) Use(offer, &Candidate::composed);
  }
  const Offer<Pose>& link = OfferOf(anchor);
  Use(anchor.offer, &Candidate::anchors);
  decision_.anchored_to = link.kept;
  current_.is_anchored = true;
  current_.T_ended_base = Compose(current_.T_base_current, Invert(link.T_kept_current), parts_.options.composition);
  current_.base = link.kept;
  current_.T_base_current = link.T_kept_current;
  current_.parent = link.MeasuredTo();
  current_.T_world_body = parts_.map.Solver().Estimate(current_.base) * current_.T_base_current.T_a_b;
}

// Those worth it, of the chain and of pairs of links; none uses what another does.
template <class Pose>
std::vector<NewEdge<Pose>> BoundedStep<Pose>::ComposeEdges(std::vector<Sighting> sightings) const {
  std::vector<NewEdge<Pose>> edges;
  if (auto edge = ComposeWithChain(sightings)) edges.push_back(std::move(*edge));
  for (int pairs = 0; pairs < kMostPairs; ++pairs) {
    auto edge = ComposePair(sightings);
    if (!edge) break;
    edges.push_back(std::move(*edge));
  }
  return edges;
}

// Takes the sighting out that tells the map most with the chain.
template <class Pose>
std::optional<NewEdge<Pose>> BoundedStep<Pose>::ComposeWithChain(std::vector<Sighting>& sightings) const {
  const Sighting* end = nullptr;
  for (const Sighting& s : sightings) {
    const PoseId kept = OfferOf(s).kept;
    if (!TellsEnough(kept, s.map_gain)) continue;
    if (!IsJoined(current_.base, kept, parts_) && !LowersVariance(current_, kept, OfferOf(s).T_kept_current, parts_))
      continue;
    if (end == nullptr || s.map_gain > end->map_gain) end = &s;
  }
  if (end == nullptr) return std::nullopt;
  const Offer<Pose>& link = OfferOf(*end);
  NewEdge<Pose> edge{current_.base,
                     link.kept,
                     ComposeBack(current_.T_base_current, link.T_kept_current, parts_.options.composition),
                     end->map_gain,
                     {end->offer},
                     {link.MeasuredTo()}};
  sightings.erase(sightings.begin() + (end - sightings.data()));
  return edge;
}

// Takes the two out that tell the map most together.
template <class Pose>
std::optional<NewEdge<Pose>> BoundedStep<Pose>::ComposePair(std::vector<Sighting>& sightings) const {
  std::optional<NewEdge<Pose>> best;
  std::pair<size_t, size_t> at;
  for (size_t a = 0; a < sightings.size(); ++a) {
    for (size_t b = a + 1; b < sightings.size(); ++b) {
      const Offer<Pose>&from = OfferOf(sightings[a]), &to = OfferOf(sightings[b]);
      NewEdge<Pose> edge{from.kept,
                         to.kept,
                         ComposeBack(from.T_kept_current, to.T_kept_current, parts_.options.composition),
                         0,
                         {sightings[a].offer, sightings[b].offer},
                         {from.MeasuredTo(), to.MeasuredTo()}};
      edge.gain = InformationGain<Pose::kDof>(parts_.map.Between(from.kept, to.kept).covariance, edge.T_a_b.covariance);
      if (edge.gain <= LeastEdgeGain(from.kept, to.kept, parts_) || (best && edge.gain <= best->gain)) continue;
      if (!IsJoined(edge.a, edge.b, parts_) && !LowersVariance(edge.a, edge.b, edge.T_a_b, parts_)) continue;
      best = std::move(edge);
      at = {a, b};
    }
  }
  if (!best) return best;
  sightings.erase(sightings.begin() + static_cast<long>(at.second));
  sightings.erase(sightings.begin() + static_cast<long>(at.first));
  return best;
}

template class BoundedStep<SE2>;
template class BoundedStep<SE3>;

}  // namespace terse::internal
