#include "terse/compact/measurement_stream.h"

#include <algorithm>
#include <stdexcept>
#include <utility>

namespace terse {
namespace {

std::string Name(PoseId id) { return "pose " + std::to_string(id.value); }

}  // namespace

template <class Pose>
struct MeasurementStream<Pose>::Offer {
  RelativePoseFactor<Pose> measured, carried;
  PoseId kept;
  bool taken = false;
};

template <class Pose>
MeasurementStream<Pose>::MeasurementStream(CompactPoseSlam<Pose>& slam) : slam_(&slam) {
  if (slam.Options().strategy == Strategy::kRfpfl) {
    throw std::invalid_argument("rfpfl draws from all poses beforehand: there is no stream of it");
  }
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::Add(const Factor<Pose>& factor) {
  const std::string defect = FindDefect(factor);
  if (!defect.empty()) throw std::invalid_argument(defect);
  if (const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&factor)) return AddEdge(*edge);
  return AddPrior(factor);
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::Flush() {
  return open_ ? Close() : std::vector<StreamOutcome>();
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::AddEdge(const RelativePoseFactor<Pose>& edge) {
  if (IsEmpty()) {
    OpenPose next = Prepare(edge.to, edge);
    OpenNext(Prepare(edge.from, std::nullopt));
    std::vector<StreamOutcome> out = Close();
    OpenNext(std::move(next));
    return out;
  }
  const bool knows_from = IsKnown(edge.from), knows_to = IsKnown(edge.to);
  if (!knows_from && !knows_to) {
    throw std::invalid_argument("edge " + std::to_string(edge.from.value) + " -> " + std::to_string(edge.to.value) +
                                ": neither pose is known");
  }
  if (knows_from && knows_to) {
    if (!IsOpen(edge.from) && !IsOpen(edge.to)) return {LinkLate(edge)};
    open_->loops.push_back(edge);
    return {};
  }
  OpenPose next = Prepare(knows_from ? edge.to : edge.from, edge);
  std::vector<StreamOutcome> out = Flush();
  OpenNext(std::move(next));
  return out;
}

template <class Pose>
LateLink MeasurementStream<Pose>::LinkLate(const RelativePoseFactor<Pose>& edge) {
  LateLink link{edge.from, edge.to, {}};
  link.decision.from = slam_->KeptBase(edge.from);
  link.decision.to = slam_->KeptBase(edge.to);
  if (link.decision.from != link.decision.to) link.decision = slam_->AddLink(edge);
  return link;
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::AddPrior(const Factor<Pose>& prior) {
  const PoseId id = PosesOf(prior).first;
  if (slam_->HasSeen(id)) return {LatePrior{id, slam_->KeptBase(id), slam_->AddPrior(prior)}};
  if (!IsOpen(id)) {
    if (!IsEmpty()) throw std::invalid_argument("a prior on " + Name(id) + ", which no edge has named yet");
    OpenNext(Prepare(id, std::nullopt));
  }
  open_->input.priors.push_back(prior);
  return {};
}

template <class Pose>
void MeasurementStream<Pose>::SetValue(PoseId id, const Pose& T_world_body) {
  if (!IsFinite(T_world_body)) throw std::invalid_argument("the value of " + Name(id) + " is not finite");
  if (slam_->HasSeen(id)) throw std::invalid_argument("the value of " + Name(id) + " comes after the pose was closed");
  (IsOpen(id) ? open_->input.T_world_body.emplace() : values_[id]) = T_world_body;
}

template <class Pose>
void MeasurementStream<Pose>::Fix(const std::vector<PoseId>& ids) {
  for (const PoseId id : ids) {
    if (slam_->HasSeen(id)) throw std::invalid_argument(Name(id) + " is fixed only after it was closed");
    if (IsOpen(id) && open_->input.odometry && !open_->input.T_world_body) {
      throw std::invalid_argument(Name(id) + " is fixed but has no value");
    }
  }
  for (const PoseId id : ids) {
    if (IsOpen(id)) {
      open_->input.fixed = true;
    } else {
      fixed_.insert(id);
    }
  }
}

// As it would be opened; nothing changes yet.
template <class Pose>
typename MeasurementStream<Pose>::OpenPose MeasurementStream<Pose>::Prepare(
    PoseId id, const std::optional<RelativePoseFactor<Pose>>& odometry) const {
  OpenPose pose;
  pose.input.id = id;
  pose.input.odometry = odometry;
  pose.input.fixed = fixed_.count(id) != 0;
  if (const auto value = values_.find(id); value != values_.end()) pose.input.T_world_body = value->second;
  if (pose.input.fixed && odometry && !pose.input.T_world_body) {
    throw std::invalid_argument(Name(id) + " is fixed but has no value");
  }
  return pose;
}

template <class Pose>
void MeasurementStream<Pose>::OpenNext(OpenPose pose) {
  values_.erase(pose.input.id);
  fixed_.erase(pose.input.id);
  open_ = std::move(pose);
}

template <class Pose>
std::vector<typename MeasurementStream<Pose>::Offer> MeasurementStream<Pose>::MakeOffers() const {
  std::vector<Offer> offers;
  for (const RelativePoseFactor<Pose>& loop : open_->loops) {
    const PoseId other = loop.from == open_->input.id ? loop.to : loop.from;
    Offer offer{loop, slam_->CarryEndToKept(other, loop), slam_->KeptBase(other)};
    // What overflows on its way is no measurement.
    if (FindDefect<Pose>(offer.carried).empty()) offers.push_back(std::move(offer));
  }
  std::stable_partition(offers.begin(), offers.end(), [](const Offer& offer) {
    return offer.measured.from == offer.carried.from && offer.measured.to == offer.carried.to;
  });
  return offers;
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::Close() {
  std::vector<Offer> offers = MakeOffers();
  const OpenPose pose = *std::exchange(open_, std::nullopt);
  CompactInput<Pose> input = pose.input;
  std::vector<PoseId> linkable;
  for (const Offer& offer : offers) linkable.push_back(offer.kept);
  input.linkable = std::move(linkable);
  const auto take = [&](PoseId candidate, PoseId) -> std::optional<RelativePoseFactor<Pose>> {
    for (Offer& offer : offers) {
      if (offer.taken || offer.kept != candidate) continue;
      offer.taken = true;
      return offer.carried;
    }
    return std::nullopt;
  };
  const Decision decision = slam_->AddPose(input, take);
  std::vector<StreamOutcome> out = {decision};
  for (const Offer& offer : offers) {
    const auto asked = std::find_if(decision.candidates.begin(), decision.candidates.end(),
                                    [&](const Candidate& c) { return c.tried && c.id == offer.kept; });
    if (!offer.taken && asked != decision.candidates.end()) out.push_back(LinkLate(offer.measured));
  }
  return out;
}

template class MeasurementStream<SE2>;
template class MeasurementStream<SE3>;

}  // namespace terse
