#include "terse/compact/measurement_stream.h"

#include <cmath>
#include <stdexcept>
#include <utility>

#include "stream_review.h"
#include "terse/compact/state_members.h"
#include "terse/core/pose_name.h"

namespace terse {
namespace {

constexpr const char* kKind = "stream of measurements";

}  // namespace

template <class Pose>
MeasurementStream<Pose>::MeasurementStream(CompactPoseSlam<Pose>& slam) : MeasurementStream(slam, InformationScale()) {}

template <class Pose>
MeasurementStream<Pose>::MeasurementStream(CompactPoseSlam<Pose>& slam, const InformationScale& scale)
    : slam_(&slam), review_(std::make_unique<internal::StreamReview<Pose>>(scale)) {
  if (slam.Options().strategy == Strategy::kGiven) {
    throw std::invalid_argument("rfpfl draws from all poses beforehand: there is no stream of it");
  }
}

template <class Pose>
MeasurementStream<Pose>::~MeasurementStream() = default;
template <class Pose>
MeasurementStream<Pose>::MeasurementStream(MeasurementStream&&) noexcept = default;
template <class Pose>
MeasurementStream<Pose>& MeasurementStream<Pose>::operator=(MeasurementStream&&) noexcept = default;

template <class Pose>
void MeasurementStream<Pose>::StartReviews(const ReviewOptions& options) {
  if (!IsEmpty()) throw std::logic_error("reviews of a stream begin before its first measurement");
  *review_ = internal::StreamReview<Pose>(slam_->Options(), options);
}

template <class Pose>
std::optional<Review> MeasurementStream<Pose>::TakeReview(bool at_end) {
  auto found = review_->Look(*slam_, at_end);
  if (!found) return std::nullopt;
  internal::RemadeMap<Pose>& remade = found->remade;
  remade.slam->SetLog(slam_->Options().log);
  *slam_ = std::move(*remade.slam);
  open_ = std::move(remade.stream.open_);
  values_ = std::move(remade.stream.values_);
  fixed_ = std::move(remade.stream.fixed_);
  found->review.decisions = std::move(remade.decisions);
  return std::move(found->review);
}

template <class Pose>
void MeasurementStream<Pose>::EndReviews() {
  review_->Stop();
}

template <class Pose>
const InformationScale& MeasurementStream<Pose>::Scale() const {
  return review_->Scale();
}

// An edge or a prior, a pose that no measurement named before.
template <class Pose>
bool MeasurementStream<Pose>::Opens(const Factor<Pose>& factor) const {
  const FactorPoses ends = PosesOf(factor);
  return !IsKnown(ends.first) || !IsKnown(ends.second);
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::Add(const Factor<Pose>& factor, bool is_scaled) {
  const std::string defect = FindDefect(factor);
  if (!defect.empty()) throw std::invalid_argument(defect);
  const bool opens = Opens(factor);
  const Factor<Pose> scaled = is_scaled ? factor : review_->Scaled(factor, opens);
  const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&scaled);
  std::vector<StreamOutcome> out = edge != nullptr ? AddEdge(*edge) : AddPrior(scaled);
  review_->Note({factor, std::nullopt, {}}, opens ? Open() : std::nullopt, out);
  return out;
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::Flush() {
  if (!open_) return {};
  std::vector<StreamOutcome> out = Close();
  review_->Note({}, std::nullopt, out);
  return out;
}

template <class Pose>
void MeasurementStream<Pose>::Discard() {
  if (open_) review_->NoteDiscarded(open_->id);
  open_.reset();
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::AddEdge(const RelativePoseFactor<Pose>& edge) {
  if (IsEmpty()) {
    CompactInput<Pose> next = Prepare(edge.to, edge);
    std::vector<StreamOutcome> out{slam_->AddPose(Prepare(edge.from, std::nullopt))};
    Forget(edge.from);
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
    AddToOpen(edge);
    return {};
  }
  const PoseId known = knows_from ? edge.from : edge.to;
  if (slam_->HasForgotten(known)) throw std::invalid_argument(Name(known) + " is forgotten: it was dropped long ago");
  CompactInput<Pose> next = Prepare(knows_from ? edge.to : edge.from, edge);
  std::vector<StreamOutcome> out = open_ ? Close() : std::vector<StreamOutcome>();
  OpenNext(std::move(next));
  return out;
}

// What leads to the latest pose is the odometry, as in a replay (graph_replay.h), in whatever order the edges come.
template <class Pose>
void MeasurementStream<Pose>::AddToOpen(const RelativePoseFactor<Pose>& edge) {
  const auto other_end = [&](const RelativePoseFactor<Pose>& e) { return IsOpen(e.from) ? e.to : e.from; };
  std::vector<RelativePoseFactor<Pose>>& loops = *open_->loops;
  const PoseId end = other_end(edge);
  if (open_->odometry && slam_->HasSeen(end)) {
    const PoseId before = other_end(*open_->odometry);
    const bool is_before_known = slam_->HasSeen(before);  // it may have been forgotten as the last pose was closed
    if (before != end && (!is_before_known || slam_->NewerOf(before, end) == end)) {
      const RelativePoseFactor<Pose> loop = std::exchange(*open_->odometry, edge);
      if (is_before_known) loops.insert(loops.begin(), loop);
      return;
    }
  }
  loops.push_back(edge);
}

template <class Pose>
LateLink MeasurementStream<Pose>::LinkLate(const RelativePoseFactor<Pose>& edge) {
  LateLink link{edge.from, edge.to, {}};
  link.forgotten = slam_->HasForgotten(edge.from) || slam_->HasForgotten(edge.to);
  if (link.forgotten) return link;
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
    if (slam_->HasForgotten(id)) throw std::invalid_argument("a prior on " + Name(id) + ", which is forgotten");
    if (!IsEmpty()) throw std::invalid_argument("a prior on " + Name(id) + ", which no edge has named yet");
    OpenNext(Prepare(id, std::nullopt));
  }
  open_->priors.push_back(prior);
  return {};
}

template <class Pose>
void MeasurementStream<Pose>::SetValue(PoseId id, const Pose& T_world_body) {
  if (!std::isfinite(T_world_body.Log().sum())) {
    throw std::invalid_argument("the value of " + Name(id) + " is beyond all numbers");
  }
  if (slam_->HasSeen(id) || slam_->HasForgotten(id))
    throw std::invalid_argument("the value of " + Name(id) + " comes after the pose was closed");
  (IsOpen(id) ? open_->T_world_body.emplace() : values_[id]) = T_world_body;
  review_->Note({std::nullopt, T_world_body, {id}});
}

template <class Pose>
void MeasurementStream<Pose>::Fix(const std::vector<PoseId>& ids) {
  for (const PoseId id : ids) {
    if (slam_->HasSeen(id) || slam_->HasForgotten(id))
      throw std::invalid_argument(Name(id) + " is fixed only after it was closed");
    if (IsOpen(id) && open_->odometry && !open_->T_world_body) {
      throw std::invalid_argument(Name(id) + " is fixed but has no value");
    }
  }
  for (const PoseId id : ids) {
    if (IsOpen(id)) {
      open_->fixed = true;
    } else {
      fixed_.insert(id);
    }
  }
  if (!ids.empty()) review_->Note({std::nullopt, std::nullopt, ids});
}

// As it would be opened; nothing changes yet.
template <class Pose>
CompactInput<Pose> MeasurementStream<Pose>::Prepare(PoseId id,
                                                    const std::optional<RelativePoseFactor<Pose>>& odometry) const {
  CompactInput<Pose> pose;
  pose.id = id;
  pose.odometry = odometry;
  pose.loops.emplace();
  pose.fixed = fixed_.count(id) != 0;
  if (const auto value = values_.find(id); value != values_.end()) pose.T_world_body = value->second;
  if (pose.fixed && odometry && !pose.T_world_body) {
    throw std::invalid_argument(Name(id) + " is fixed but has no value");
  }
  return pose;
}

template <class Pose>
void MeasurementStream<Pose>::OpenNext(CompactInput<Pose> pose) {
  Forget(pose.id);
  open_ = std::move(pose);
}

template <class Pose>
void MeasurementStream<Pose>::Forget(PoseId id) {
  values_.erase(id);
  fixed_.erase(id);
}

template <class Pose>
std::vector<StreamOutcome> MeasurementStream<Pose>::Close() {
  std::vector<StreamOutcome> out{slam_->AddPose(*open_)};
  open_.reset();
  return out;
}

// But for `slam`.
template <class Pose>
template <class Archive>
void MeasurementStream<Pose>::Serialize(Archive& archive) {
  auto& [slam, open, values, fixed, review] = *this;
  std::vector<PoseId> fixed_list(fixed.begin(), fixed.end());
  archive(open, values, fixed_list, *review);
  if constexpr (Archive::kReads) fixed = std::set<PoseId>(fixed_list.begin(), fixed_list.end());
}

template <class Pose>
void MeasurementStream<Pose>::Save(const std::string& path) const {
  StateWriter writer(StateKind<Pose>(kKind));
  writer(*slam_, *this);
  std::move(writer).Save(path);
}

template <class Pose>
MeasurementStream<Pose> MeasurementStream<Pose>::Load(const std::string& path, CompactPoseSlam<Pose>& slam) {
  StateReader reader(path, StateKind<Pose>(kKind));
  CompactPoseSlam<Pose> loaded;
  MeasurementStream stream(loaded);
  try {
    reader(loaded, stream);
  } catch (const std::logic_error& error) {
    reader.Fail(error.what());
  }
  reader.Finish();
  if (loaded.Options().strategy == Strategy::kGiven) reader.Fail("the strategy given takes no stream");
  const auto is_seen = [&](PoseId id) { return loaded.HasSeen(id) || loaded.HasForgotten(id); };
  if (stream.open_ && is_seen(stream.open_->id)) reader.Fail("the pose at hand was added already");
  for (const auto& [id, value] : stream.values_) {
    if (is_seen(id) || !IsFinite(value)) reader.Fail("a value of a pose that was added already, or not finite");
  }
  if (const std::string defect = stream.review_->FindStateDefect(); !defect.empty()) reader.Fail(defect);
  loaded.SetLog(slam.Options().log);
  slam = std::move(loaded);
  stream.slam_ = &slam;
  stream.review_->Resume(slam);
  return stream;
}

template class MeasurementStream<SE2>;
template class MeasurementStream<SE3>;

}  // namespace terse
