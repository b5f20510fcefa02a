// The links of a pose: loops that came with it, or registrations of what the search found (Algorithm 1, lines 6-17).

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "compact_pose_slam_parts.h"
#include "terse/compact/information.h"
#include "terse/compact/innovation.h"
#include "terse/core/at.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

}  // namespace

template <class Pose>
void RecordCandidates(std::vector<Candidate> settled, const CompactOptions<Pose>& options, Decision& decision) {
  decision.candidates_found = static_cast<int>(settled.size());
  if (options.record == Record::kNone) return;
  const auto others = std::stable_partition(settled.begin(), settled.end(), [](const Candidate& c) { return c.tried; });
  const long room =
      options.record == Record::kDecisions ? 0 : std::min<long>(options.most_recorded, settled.end() - others);
  std::partial_sort(others, others + room, settled.end(), [](const Candidate& a, const Candidate& b) {
    return a.gain != b.gain ? a.gain > b.gain : a.id < b.id;
  });
  settled.erase(others + room, settled.end());
  settled.shrink_to_fit();
  decision.candidates = std::move(settled);
}

// A loop at the kept pose that its other end hangs on. False if it overflows on its way there.
template <class Pose>
bool CompactPoseSlam<Pose>::TakeOffer(const Current& current, const RelativePoseFactor<Pose>& loop,
                                      Offer& offer) const {
  const PoseId other = loop.from == current.input->id ? loop.to : loop.from;
  offer.measured = loop;
  offer.link = CarryEndToKept(other, loop);
  if (!FindDefect<Pose>(offer.link).empty()) return false;
  offer.kept = KeptBase(other);
  offer.carried_from = offer.kept != other ? std::optional<PoseId>(other) : std::nullopt;
  if (offer.carried_from && IsSpent(other)) return false;
  offer.T_kept_current = SeenFrom(offer.kept, offer.link);
  offer.carried = offer.T_kept_current.covariance - SeenFrom(other, loop).covariance;
  offer.T_dropped_current.reset();
  if (offer.carried_from && !current.in_solver && offer.kept == current.base && !Find(other).next_kept &&
      IsPlainChain(other, current.parent, 0)) {
    offer.T_dropped_current = Behind(Find(other).T_base_pose, current.T_base_current);
  }
  return true;
}

// The stretch that the one which starts here hangs on, where a link to a dropped pose starts it; -1 at a kept pose.
template <class Pose>
int CompactPoseSlam<Pose>::StretchBefore(int stretch) const {
  return history_[At(history_[At(stretch)].parent)].stretch;
}

// Whether a chain that a dropped pose hangs on has served to carry a loop already: in a bounded map, where robots
// pass again and again, no measurement counts twice.
template <class Pose>
bool CompactPoseSlam<Pose>::IsSpent(PoseId dropped) const {
  if (options_.strategy != Strategy::kBounded) return false;
  for (int s = Find(dropped).stretch; s >= 0; s = StretchBefore(s)) {
    if (history_[At(s)].carried) return true;
  }
  return false;
}

// What a pose, in history_, hangs on has come into the map.
template <class Pose>
void CompactPoseSlam<Pose>::SpendChain(int pose) {
  for (int s = history_[At(pose)].stretch; s >= 0; s = StretchBefore(s)) history_[At(s)].carried = true;
}

template <class Pose>
void CompactPoseSlam<Pose>::Spend(const Offer& offer) {
  if (offer.carried_from && options_.strategy == Strategy::kBounded) SpendChain(index_.at(offer.carried_from->value));
}

template <class Pose>
void CompactPoseSlam<Pose>::TakeOffers(Current& current) const {
  if (!current.input->loops) return;
  for (const RelativePoseFactor<Pose>& loop : *current.input->loops) {
    Offer offer;
    if (TakeOffer(current, loop, offer)) current.offers.push_back(std::move(offer));
  }
}

template <class Pose>
std::optional<RelativePoseFactor<Pose>> CompactPoseSlam<Pose>::Register(const Registration<Pose>& registration,
                                                                        PoseId candidate, PoseId current) const {
  std::optional<RelativePoseFactor<Pose>> link = registration ? registration(candidate, current) : std::nullopt;
  if (!link) return link;
  const bool joins =
      (link->from == candidate && link->to == current) || (link->from == current && link->to == candidate);
  if (!joins) throw std::invalid_argument("the registration returned a link between other poses than asked for");
  const std::string defect = FindDefect<Pose>(*link);
  if (!defect.empty()) throw std::invalid_argument(defect);
  return link;
}

template <class Pose>
void CompactPoseSlam<Pose>::LogLink(PoseId a, PoseId b, const Candidate& record, bool good) const {
  if (!options_.log) return;
  const char* what = good                ? " added: gain "
                     : IsRefused(record) ? " refused by the innovation test: gain "
                                         : " tells too little: gain ";
  const LogLevel level = good || IsRefused(record) ? LogLevel::kInfo : LogLevel::kDebug;
  internal::Log(options_.log, level, "link ", a.value, " - ", b.value, what, *record.measured_gain, " nats (threshold ",
                gains_->MinLoopGain(), "), innovation ", record.innovation.value_or(0), " (at most ", most_innovation_,
                record.supported ? ", but other refused links agree)" : ")");
}

// Whether a registered link agrees with the map: between record.id and the pose at hand, or two poses seen before
// (`current` absent). An outlier may be supported by other links of the pose at hand; if it is not, it may support a
// later one.
template <class Pose>
bool CompactPoseSlam<Pose>::IsBelieved(const Current* current, const UncertainPose<Pose>& known,
                                       const UncertainPose<Pose>& measured, Candidate& record) {
  if (options_.innovation_quantile) {
    record.innovation = InnovationDistance(known, measured);
    record.outlier = !(*record.innovation <= most_innovation_);
  }
  if (record.outlier && current != nullptr) {
    record.supported = IsSupported(*current, record.id, measured);
    if (!record.supported) RememberRefused(*current, record.id, measured);
  }
  return !IsRefused(record);
}

// And whether its measured gain is enough for it to be added.
template <class Pose>
bool CompactPoseSlam<Pose>::PassesTests(const Current* current, const UncertainPose<Pose>& known,
                                        const UncertainPose<Pose>& measured, Candidate& record) {
  return IsBelieved(current, known, measured, record) && *record.measured_gain > gains_->MinLoopGain();
}

// Tests a registered link and adds it if it passes. Whether it did.
template <class Pose>
bool CompactPoseSlam<Pose>::Accept(Current& current, Evaluated& candidate, const RelativePoseFactor<Pose>& link,
                                   Decision& decision) {
  Candidate& record = candidate.record;
  const UncertainPose<Pose>& known = candidate.T_pose_current;
  const Offer* offer = candidate.ask.offer >= 0 ? &current.offers[At(candidate.ask.offer)] : nullptr;
  if (offer != nullptr && offer->T_dropped_current) return AcceptOnChain(current, Offer(*offer), record, decision);
  const UncertainPose<Pose> measured = SeenFrom(record.id, link);
  record.measured_gain = offer == nullptr || !offer->carried_from
                             ? InformationGain<Pose::kDof>(known.covariance, measured.covariance)
                             : OfferGain(current, *offer, known, measured.covariance - offer->carried);
  // Where the sensor cannot have seen the pose nothing is believed because others say the same: of many wrong loops
  // some agree by chance.
  const bool good = PassesTests(candidate.plausible ? &current : nullptr, known, measured, record);
  LogLink(record.id, current.input->id, record, good);
  if (IsRefused(record)) ++decision.links_refused;
  if (!good) return false;
  std::optional<Revival> revival;
  if (offer != nullptr && offer->carried_from && IsCostlyToCarry(*offer, known))
    revival = PlanRevival(*offer->carried_from);
  if (revival) {
    record.factor = Keep(current, {offer->measured}, &*revival).back();
    record.id = revival->pose;
    record.carried_from.reset();
    decision.revived.push_back(revival->pose);
  } else {
    record.factor = Keep(current, {link}).back();
    if (offer != nullptr) Spend(*offer);
  }
  record.accepted = true;
  ++decision.links_accepted;
  links_.back().gain = record.measured_gain;
  return true;
}

// The same for a loop to a dropped pose of the pose's own chain: it tells of the chain between the two, so both are
// kept.
template <class Pose>
bool CompactPoseSlam<Pose>::AcceptOnChain(Current& current, const Offer& offer, Candidate& record, Decision& decision) {
  const PoseId dropped = *offer.carried_from;
  const UncertainPose<Pose> measured = SeenFrom(dropped, offer.measured);
  record.measured_gain = InformationGain<Pose::kDof>(offer.T_dropped_current->covariance, measured.covariance);
  const bool good = PassesTests(nullptr, *offer.T_dropped_current, measured, record);
  LogLink(dropped, current.input->id, record, good);
  if (IsRefused(record)) ++decision.links_refused;
  if (!good) return false;
  const Revival revival = PlanRevivalOnChain(dropped, current);
  const Current before = current;
  current.base = dropped;
  current.T_base_current = current.chain = *offer.T_dropped_current;
  current.concatenated = history_[At(current.parent)].id != dropped;
  try {
    record.factor = Keep(current, {offer.measured}, &revival).back();
  } catch (...) {
    current = before;
    throw;
  }
  record.accepted = true;
  record.id = dropped;
  record.carried_from.reset();
  ++decision.links_accepted;
  decision.revived.push_back(dropped);
  links_.back().gain = record.measured_gain;
  return true;
}

// Whether the chain takes more from the loop than a link must tell.
template <class Pose>
bool CompactPoseSlam<Pose>::IsCostlyToCarry(const Offer& offer, const UncertainPose<Pose>& known) const {
  const auto& direct = SeenFrom(*offer.carried_from, offer.measured).covariance;
  return InformationGain<Pose::kDof>(known.covariance, direct) -
             InformationGain<Pose::kDof>(known.covariance, offer.T_kept_current.covariance) >
         gains_->MinLoopGain();
}

// Which poses may be linked, and what the least informative of the links that are surely possible would tell: from
// that it is judged whether the pose says anything new.
template <class Pose>
void CompactPoseSlam<Pose>::Search(Current& current, Decision& decision, const Registration<Pose>& registration) {
  const bool registers = registration != nullptr && !current.input->loops;
  std::vector<Evaluated> candidates = Evaluate(current, InReach(current, registers), registers);
  for (const Evaluated& e : candidates) {
    if (e.record.probability <= options_.thresholds.probability) continue;
    if (registers && options_.budget.error) current.in_range.emplace_back(e.record.id, e.record.probability);
    decision.pose_gain = std::min(decision.pose_gain.value_or(e.record.gain), e.record.gain);
  }
  for (size_t k = 0; k < current.offers.size(); ++k) {
    const int pose = solver_->Graph().IndexOf(current.offers[k].kept);
    for (Evaluated& e : Evaluate(current, {{pose, static_cast<int>(k)}}, true)) candidates.push_back(std::move(e));
  }
  CloseLoops(current, std::move(candidates), decision, registers ? registration : nullptr);
}

// Best first, the rest evaluated again after every accepted link.
template <class Pose>
void CompactPoseSlam<Pose>::CloseLoops(Current& current, std::vector<Evaluated> candidates, Decision& decision,
                                       const Registration<Pose>& registration) {
  // Odometry measures this displacement already.
  const PoseId base = current.base;
  const bool is_linked = !current.concatenated;
  std::vector<Failed> failed = registration ? FailedNear(current) : std::vector<Failed>();
  std::vector<Candidate> settled;
  // A loop that was registered for the pose already (compact_bounded.cpp) has been counted.
  const auto is_registered = [&](const Evaluated& e) { return e.ask.offer >= 0 && !current.input->loops; };
  while (true) {
    const bool may_try = decision.registrations_tried < options_.max_registrations;
    Evaluated* best = nullptr;
    for (Evaluated& e : candidates) {
      const bool asks = e.ask.offer >= 0 || registration != nullptr;
      if (!asks || e.record.tried || !(may_try || is_registered(e))) continue;
      if (!is_registered(e) && e.record.gain <= gains_->MinLoopGain()) continue;
      if (best != nullptr && e.worth <= best->worth) continue;
      if (e.ask.offer < 0 && ((is_linked && e.record.id == base) || IsNearFailed(failed, e.record.id))) continue;
      best = &e;
    }
    if (best == nullptr) break;
    best->record.tried = true;
    if (!is_registered(*best)) ++decision.registrations_tried;
    const std::optional<RelativePoseFactor<Pose>> link =
        best->ask.offer >= 0 ? std::optional<RelativePoseFactor<Pose>>(current.offers[At(best->ask.offer)].link)
                             : Register(registration, best->record.id, current.input->id);
    if (!link) {
      failed.push_back({best->record.id, current.input->id});
      failed_.push_back(failed.back());
      continue;
    }
    try {
      if (!Accept(current, *best, *link, decision)) continue;
    } catch (const NumericalError& error) {  // with this link the map has no solution: it goes, the pose stays
      best->record.outlier = true;
      best->record.supported = false;
      ++decision.links_refused;
      internal::Log(options_.log, LogLevel::kInfo, "link ", best->record.id.value, " - ", current.input->id.value,
                    " refused: ", error.what());
      continue;
    }
    // What only told the range has done so. A pose that came back is another one for loops to hang on.
    std::vector<Ask> rest;
    for (Evaluated& e : candidates) {
      bool is_open = !e.record.tried && (e.ask.offer >= 0 || registration != nullptr);
      if (is_open && e.ask.offer >= 0 && !decision.revived.empty()) {
        Offer& offer = current.offers[At(e.ask.offer)];
        is_open = TakeOffer(current, RelativePoseFactor<Pose>(offer.measured), offer);
        if (is_open) e.ask.pose = solver_->Graph().IndexOf(offer.kept);
      }
      if (is_open) {
        rest.push_back(e.ask);
      } else {
        settled.push_back(e.record);
      }
    }
    candidates = Evaluate(current, rest, true);
  }
  for (const Evaluated& e : candidates) settled.push_back(e.record);
  RecordCandidates(std::move(settled), options_, decision);
}

template <class Pose>
void CompactPoseSlam<Pose>::LinkAll(Current& current, Decision& decision, const Registration<Pose>& registration) {
  std::vector<Factor<Pose>> links;
  const auto record = [&](PoseId id, const std::optional<RelativePoseFactor<Pose>>& link) -> Candidate& {
    Candidate candidate;
    candidate.id = id;
    candidate.tried = true;
    candidate.accepted = link.has_value();
    ++decision.registrations_tried;
    if (link) {
      ++decision.links_accepted;
      links.emplace_back(*link);
    }
    return decision.candidates.emplace_back(candidate);
  };
  const CompactInput<Pose>& input = *current.input;
  if (input.loops) {
    for (const Offer& offer : current.offers) record(offer.kept, offer.link).carried_from = offer.carried_from;
  } else if (input.linkable) {
    for (const PoseId id : *input.linkable) record(id, Register(registration, id, input.id));
  } else if (options_.strategy == Strategy::kApal) {
    for (const Evaluated& e : Evaluate(current, InReach(current, false), false)) {
      if (!current.concatenated && e.record.id == current.base) continue;
      record(e.record.id, Register(registration, e.record.id, input.id));
    }
  }
  const std::vector<FactorId> ids = Keep(current, std::move(links));
  size_t next = 0;
  for (Candidate& candidate : decision.candidates) {
    if (candidate.accepted) candidate.factor = ids[next++];
  }
  RecordCandidates(std::exchange(decision.candidates, {}), options_, decision);
}

template <class Pose>
bool CompactPoseSlam<Pose>::AreNeighbours(const Pose& T_world_a, const Pose& T_world_b) const {
  const auto apart = DisplacementMean<Pose>(T_world_a.Inverse() * T_world_b, options_.distance);
  return (apart.cwiseAbs().array() <= options_.failed_neighbourhood * options_.thresholds.range.array()).all();
}

// Registrations that failed where the pose at hand is. Those of an earlier visit count as well, as far as the map knows
// that it is the same place.
template <class Pose>
std::vector<typename CompactPoseSlam<Pose>::Failed> CompactPoseSlam<Pose>::FailedNear(const Current& current) const {
  std::vector<Failed> out;
  for (const Failed& failed : failed_) {
    const bool is_own = failed.seen == current.input->id;  // which is not remembered yet
    if (is_own || AreNeighbours(Estimate(failed.seen), current.T_world_body)) out.push_back(failed);
  }
  return out;
}

template <class Pose>
bool CompactPoseSlam<Pose>::IsNearFailed(const std::vector<Failed>& failed, PoseId candidate) const {
  return std::any_of(failed.begin(), failed.end(), [&](const Failed& f) {
    return f.candidate == candidate || AreNeighbours(solver_->Estimate(f.candidate), solver_->Estimate(candidate));
  });
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template void RecordCandidates<Pose>(std::vector<Candidate>, const CompactOptions<Pose>&, Decision&);               \
  template int CompactPoseSlam<Pose>::StretchBefore(int) const;                                                       \
  template bool CompactPoseSlam<Pose>::IsSpent(PoseId) const;                                                         \
  template void CompactPoseSlam<Pose>::SpendChain(int);                                                               \
  template void CompactPoseSlam<Pose>::Spend(const Offer&);                                                           \
  template bool CompactPoseSlam<Pose>::IsBelieved(const Current*, const UncertainPose<Pose>&,                         \
                                                  const UncertainPose<Pose>&, Candidate&);                            \
  template void CompactPoseSlam<Pose>::TakeOffers(Current&) const;                                                    \
  template bool CompactPoseSlam<Pose>::TakeOffer(const Current&, const RelativePoseFactor<Pose>&, Offer&) const;      \
  template bool CompactPoseSlam<Pose>::AcceptOnChain(Current&, const Offer&, Candidate&, Decision&);                  \
  template bool CompactPoseSlam<Pose>::IsCostlyToCarry(const Offer&, const UncertainPose<Pose>&) const;               \
  template std::optional<RelativePoseFactor<Pose>> CompactPoseSlam<Pose>::Register(const Registration<Pose>&, PoseId, \
                                                                                   PoseId) const;                     \
  template bool CompactPoseSlam<Pose>::Accept(Current&, Evaluated&, const RelativePoseFactor<Pose>&, Decision&);      \
  template void CompactPoseSlam<Pose>::CloseLoops(Current&, std::vector<Evaluated>, Decision&,                        \
                                                  const Registration<Pose>&);                                         \
  template std::vector<CompactPoseSlam<Pose>::Failed> CompactPoseSlam<Pose>::FailedNear(const Current&) const;        \
  template bool CompactPoseSlam<Pose>::IsNearFailed(const std::vector<Failed>&, PoseId) const;                        \
  template bool CompactPoseSlam<Pose>::AreNeighbours(const Pose&, const Pose&) const;                                 \
  template void CompactPoseSlam<Pose>::Search(Current&, Decision&, const Registration<Pose>&);                        \
  template void CompactPoseSlam<Pose>::LinkAll(Current&, Decision&, const Registration<Pose>&);                       \
  template bool CompactPoseSlam<Pose>::PassesTests(const Current*, const UncertainPose<Pose>&,                        \
                                                   const UncertainPose<Pose>&, Candidate&);                           \
  template void CompactPoseSlam<Pose>::LogLink(PoseId, PoseId, const Candidate&, bool) const;
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
