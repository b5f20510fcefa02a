#include "loop_closing.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

#include "pose_step.h"
#include "revival.h"
#include "terse/compact/information.h"
#include "terse/core/at.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse::internal {

using std::size_t;

template <class Pose>
void LoopClosing<Pose>::Search() {
  const bool registers = Registers();
  std::vector<Evaluated<Pose>> candidates =
      parts_.search.Evaluate(current_, parts_.search.InReach(current_, registers), registers);
  for (const Evaluated<Pose>& e : candidates) NotePoseGain(e.record, registers, parts_.options, current_, decision_);
  for (size_t k = 0; k < current_.offers.size(); ++k) {
    candidates.push_back(parts_.search.EvaluateOffer(current_, static_cast<int>(k)));
  }
  CloseLoops(std::move(candidates));
}

template <class Pose>
void LoopClosing<Pose>::CloseLoops(std::vector<Evaluated<Pose>> candidates) {
  open_ = std::move(candidates);
  if (!current_.concatenated) linked_ = current_.base;
  if (Registers()) failed_ = parts_.tests.FailedNear(current_);
  while (Evaluated<Pose>* best = Next()) {
    if (Try(*best)) EvaluateAgain();
  }
  for (const Evaluated<Pose>& e : open_) settled_.push_back(e.record);
  RecordCandidates(std::move(settled_), parts_.options, decision_);
}

// The best one that may be tried; nullptr if there is none.
template <class Pose>
Evaluated<Pose>* LoopClosing<Pose>::Next() {
  const bool may_try = decision_.registrations_tried < parts_.options.max_registrations;
  Evaluated<Pose>* best = nullptr;
  for (Evaluated<Pose>& e : open_) {
    const bool asks = e.ask.offer >= 0 || Registers(), is_registered = IsRegistered(e.ask);
    if (!asks || e.record.tried || !(may_try || is_registered)) continue;
    if (!is_registered && e.record.gain <= parts_.gains.MinLoopGain()) continue;
    if (best != nullptr && e.worth <= best->worth) continue;
    if (e.ask.offer < 0 && (e.record.id == linked_ || parts_.tests.IsNearFailed(failed_, e.record.id))) continue;
    best = &e;
  }
  return best;
}

// Whether the link was added.
template <class Pose>
bool LoopClosing<Pose>::Try(Evaluated<Pose>& candidate) {
  Candidate& record = candidate.record;
  const Ask& ask = candidate.ask;
  const PoseId id = current_.input->id;
  record.tried = true;
  if (!IsRegistered(ask)) ++decision_.registrations_tried;
  const std::optional<Link> link = ask.offer >= 0 ? std::optional<Link>(current_.offers[At(ask.offer)].link)
                                                  : Register(registration_, record.id, id);
  if (!link) {
    failed_.push_back({record.id, id});
    parts_.tests.NoteFailed(failed_.back());
    return false;
  }
  try {
    return Accept(candidate, *link);
  } catch (const NumericalError& error) {  // with this link the map has no solution: it goes, the pose stays
    record.outlier = true;
    record.supported = false;
    ++decision_.links_refused;
    Log(parts_.options.log, LogLevel::kInfo, "link ", record.id.value, " - ", id.value, " refused: ", error.what());
    return false;
  }
}

// What only told the range has done so. A pose that came back is another one for loops to hang on.
template <class Pose>
void LoopClosing<Pose>::EvaluateAgain() {
  std::vector<Ask> rest;
  for (Evaluated<Pose>& e : open_) {
    bool is_open = !e.record.tried && (e.ask.offer >= 0 || Registers());
    if (is_open && e.ask.offer >= 0 && !decision_.revived.empty()) {
      Offer<Pose>& offer = current_.offers[At(e.ask.offer)];
      auto again = TakeOffer(offer.measured, current_, parts_.history, parts_.options);
      is_open = again.has_value();
      if (again) offer = std::move(*again);
      if (is_open) e.ask.pose = parts_.map.Solver().Graph().IndexOf(offer.kept);
    }
    if (is_open) {
      rest.push_back(e.ask);
    } else {
      settled_.push_back(e.record);
    }
  }
  open_ = parts_.search.Evaluate(current_, rest, true);
}

// Tests a link and adds it if it passes. Whether it did.
template <class Pose>
bool LoopClosing<Pose>::Accept(Evaluated<Pose>& candidate, const Link& link) {
  Candidate& record = candidate.record;
  const UncertainPose<Pose>& known = candidate.T_pose_current;
  const Offer<Pose>* offer = candidate.ask.offer >= 0 ? &current_.offers[At(candidate.ask.offer)] : nullptr;
  if (offer != nullptr && offer->T_dropped_current) return AcceptOnChain(Offer<Pose>(*offer), record);
  const UncertainPose<Pose> measured = SeenFrom(record.id, link);
  record.measured_gain = offer == nullptr || !offer->carried_from
                             ? InformationGain<Pose::kDof>(known.covariance, measured.covariance)
                             : OfferGain<Pose>(*offer, current_, known, measured.covariance - offer->carried);
  // Where the sensor cannot have seen the pose nothing is believed because others say the same: of many wrong loops
  // some agree by chance.
  const bool good = PassesTests(candidate.plausible ? &current_ : nullptr, known, measured, record, parts_) &&
                    LowersVariance(current_, record.id, measured, parts_);
  LogLink(record.id, current_.input->id, record, good, parts_);
  if (IsRefused(record)) ++decision_.links_refused;
  if (!good) return false;
  std::optional<Revival<Pose>> revival;
  if (offer != nullptr && offer->carried_from && IsCostlyToCarry(*offer, known))
    revival = PlanRevival(*offer->carried_from, parts_);
  if (revival) {
    record.factor = Keep({offer->measured}, current_, parts_, &*revival).back();
    NoteAccepted(record, revival->pose);
    return true;
  }
  record.factor = Keep({link}, current_, parts_).back();
  if (offer != nullptr) Spend(*offer, parts_.options, parts_.history);
  NoteAccepted(record, std::nullopt);
  return true;
}

// The same for a loop to a dropped pose of the pose's own chain: it tells of the chain between the two, so both are
// kept.
template <class Pose>
bool LoopClosing<Pose>::AcceptOnChain(const Offer<Pose>& offer, Candidate& record) {
  const PoseId dropped = *offer.carried_from;
  const UncertainPose<Pose> measured = SeenFrom(dropped, offer.measured);
  record.measured_gain = InformationGain<Pose::kDof>(offer.T_dropped_current->covariance, measured.covariance);
  const bool good = PassesTests<Pose>(nullptr, *offer.T_dropped_current, measured, record, parts_);
  LogLink(dropped, current_.input->id, record, good, parts_);
  if (IsRefused(record)) ++decision_.links_refused;
  if (!good) return false;
  const Revival<Pose> revival = PlanRevivalOnChain(dropped, current_, parts_.history);
  const CurrentPose<Pose> before = current_;
  current_.base = dropped;
  current_.T_base_current = current_.chain = *offer.T_dropped_current;
  current_.concatenated = current_.parent != dropped;
  try {
    record.factor = Keep({offer.measured}, current_, parts_, &revival).back();
  } catch (...) {
    current_ = before;
    throw;
  }
  NoteAccepted(record, dropped);
  return true;
}

template <class Pose>
void LoopClosing<Pose>::NoteAccepted(Candidate& record, std::optional<PoseId> revived) {
  record.accepted = true;
  ++decision_.links_accepted;
  parts_.links.SetGain(*record.factor, *record.measured_gain);
  if (!revived) return;
  record.id = *revived;
  record.carried_from.reset();
  decision_.revived.push_back(*revived);
}

// Whether the chain takes more from the loop than a link must tell.
template <class Pose>
bool LoopClosing<Pose>::IsCostlyToCarry(const Offer<Pose>& offer, const UncertainPose<Pose>& known) const {
  const auto& direct = SeenFrom(*offer.carried_from, offer.measured).covariance;
  return InformationGain<Pose::kDof>(known.covariance, direct) -
             InformationGain<Pose::kDof>(known.covariance, offer.T_kept_current.covariance) >
         parts_.gains.MinLoopGain();
}

template <class Pose>
Candidate& LoopClosing<Pose>::Take(PoseId id, const std::optional<Link>& link, std::vector<Factor<Pose>>& links) {
  Candidate candidate;
  candidate.id = id;
  candidate.tried = true;
  candidate.accepted = link.has_value();
  ++decision_.registrations_tried;
  if (link) {
    ++decision_.links_accepted;
    links.emplace_back(*link);
  }
  return decision_.candidates.emplace_back(candidate);
}

template <class Pose>
void LoopClosing<Pose>::LinkAll() {
  const CompactInput<Pose>& input = *current_.input;
  std::vector<Factor<Pose>> links;
  if (input.loops) {
    for (const Offer<Pose>& offer : current_.offers) {
      Take(offer.kept, offer.link, links).carried_from = offer.carried_from;
    }
  } else if (input.linkable) {
    for (const PoseId id : *input.linkable) Take(id, Register(registration_, id, input.id), links);
  } else if (parts_.options.strategy == Strategy::kApal) {
    for (const auto& e : parts_.search.Evaluate(current_, parts_.search.InReach(current_, false), false)) {
      if (current_.IsLinkedTo(e.record.id)) continue;
      Take(e.record.id, Register(registration_, e.record.id, input.id), links);
    }
  }
  const std::vector<FactorId> ids = Keep(links, current_, parts_);
  size_t next = 0;
  for (Candidate& candidate : decision_.candidates) {
    if (candidate.accepted) candidate.factor = ids[next++];
  }
  RecordCandidates(std::exchange(decision_.candidates, {}), parts_.options, decision_);
}

template <class Pose>
bool PassesTests(const CurrentPose<Pose>* current, const UncertainPose<Pose>& known,
                 const UncertainPose<Pose>& measured, Candidate& record, CompactParts<Pose>& parts) {
  return parts.tests.IsBelieved(current, known, measured, record) && *record.measured_gain > parts.gains.MinLoopGain();
}

template <class Pose>
bool LowersVariance(PoseId a, PoseId b, const UncertainPose<Pose>& T_a_b, CompactParts<Pose>& parts) {
  const double share = parts.options.min_variance_drop;
  if (share == 0 || parts.options.strategy != Strategy::kBounded) return true;
  return parts.variance.ShareTold(a, b, T_a_b.covariance) > share;
}

template <class Pose>
bool LowersVariance(const CurrentPose<Pose>& current, PoseId kept, const UncertainPose<Pose>& T_kept_current,
                    CompactParts<Pose>& parts) {
  return LowersVariance(current.base, kept,
                        Compose(current.T_base_current, Invert(T_kept_current), parts.options.composition), parts);
}

template <class Pose>
std::optional<RelativePoseFactor<Pose>> Register(const Registration<Pose>& registration, PoseId candidate,
                                                 PoseId current) {
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
void LogLink(PoseId a, PoseId b, const Candidate& record, bool good, const CompactParts<Pose>& parts,
             const char* passed) {
  if (!parts.options.log) return;
  const char* what = good ? passed : IsRefused(record) ? "refused by the innovation test" : "tells too little";
  const LogLevel level = good || IsRefused(record) ? LogLevel::kInfo : LogLevel::kDebug;
  Log(parts.options.log, level, "link ", a.value, " - ", b.value, " ", what, ": gain ", *record.measured_gain,
      " nats (threshold ", parts.gains.MinLoopGain(), "), innovation ", record.innovation.value_or(0), " (at most ",
      parts.tests.MostInnovation(), record.supported ? ", but other refused links agree)" : ")");
}

template <class Pose>
void NotePoseGain(const Candidate& candidate, bool registers, const CompactOptions<Pose>& options,
                  CurrentPose<Pose>& current, Decision& decision) {
  if (candidate.probability <= options.thresholds.probability) return;
  decision.pose_gain = std::min(decision.pose_gain.value_or(candidate.gain), candidate.gain);
  if (registers && options.budget.error) current.in_range.emplace_back(candidate.id, candidate.probability);
}

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

#define TERSE_INSTANTIATE(Pose)                                                                                    \
  template class LoopClosing<Pose>;                                                                                \
  template bool PassesTests(const CurrentPose<Pose>*, const UncertainPose<Pose>&, const UncertainPose<Pose>&,      \
                            Candidate&, CompactParts<Pose>&);                                                      \
  template bool LowersVariance(PoseId, PoseId, const UncertainPose<Pose>&, CompactParts<Pose>&);                   \
  template bool LowersVariance(const CurrentPose<Pose>&, PoseId, const UncertainPose<Pose>&, CompactParts<Pose>&); \
  template std::optional<RelativePoseFactor<Pose>> Register(const Registration<Pose>&, PoseId, PoseId);            \
  template void LogLink(PoseId, PoseId, const Candidate&, bool, const CompactParts<Pose>&, const char*);           \
  template void NotePoseGain(const Candidate&, bool, const CompactOptions<Pose>&, CurrentPose<Pose>&, Decision&);  \
  template void RecordCandidates(std::vector<Candidate>, const CompactOptions<Pose>&, Decision&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
