#include "terse/compact/compact_pose_slam.h"

#include <cmath>
#include <stdexcept>

#include "bounded_step.h"
#include "carry.h"
#include "loop_closing.h"
#include "map_exchange.h"
#include "pose_recovery.h"
#include "pose_step.h"
#include "retiring.h"
#include "terse/compact/information.h"
#include "terse/compact/state_members.h"
#include "terse/core/log_message.h"

namespace terse {

using internal::CurrentPose;

template <class Pose>
CompactPoseSlam<Pose>::CompactPoseSlam(const CompactOptions<Pose>& options)
    : parts_(std::make_unique<Parts>(options)) {}

template <class Pose>
CompactPoseSlam<Pose>::~CompactPoseSlam() = default;
template <class Pose>
CompactPoseSlam<Pose>::CompactPoseSlam(CompactPoseSlam&&) noexcept = default;
template <class Pose>
CompactPoseSlam<Pose>& CompactPoseSlam<Pose>::operator=(CompactPoseSlam&&) noexcept = default;

template <class Pose>
Decision CompactPoseSlam<Pose>::AddPose(PoseId id, const std::optional<RelativePoseFactor<Pose>>& odometry,
                                        const Registration<Pose>& registration) {
  CompactInput<Pose> input;
  input.id = id;
  input.odometry = odometry;
  return AddPose(input, registration);
}

template <class Pose>
Decision CompactPoseSlam<Pose>::AddPose(const CompactInput<Pose>& input, const Registration<Pose>& registration) {
  Parts& parts = *parts_;
  const Strategy strategy = parts.options.strategy;
  CurrentPose<Pose> current = internal::Arrive(input, parts);
  Decision decision;
  decision.id = input.id;
  decision.loops_forgotten = internal::TakeOffers(current, parts.history, parts.options);
  const bool counts_loops = parts.options.budget.error && !parts.history.IsEmpty();
  SeenLoops<Pose> seen;
  if (counts_loops) seen = internal::LoopsOf(current, parts);
  const Registration<Pose> watched = counts_loops ? Watched(registration, seen) : nullptr;
  const Registration<Pose>& sensor = counts_loops ? watched : registration;
  try {
    parts.tests.NoteOdometry(input);
    if (parts.history.IsEmpty()) {
      internal::Keep({}, current, parts);
    } else if (strategy == Strategy::kApfl || strategy == Strategy::kFpfl) {
      internal::LoopClosing<Pose>(current, decision, sensor, parts).Search();
    } else if (strategy == Strategy::kBounded) {
      internal::BoundedStep<Pose>(current, decision, sensor, parts).Run();
    } else if (strategy == Strategy::kApal || input.keep) {
      internal::LoopClosing<Pose>(current, decision, sensor, parts).LinkAll();
    }
    decision.verdict = internal::Judge(current, decision, parts);
    if (decision.Kept()) internal::Keep({}, current, parts);
    decision.update = std::move(current.update);
  } catch (...) {
    if (current.in_solver) {
      internal::Remember(current, parts.history);
      parts.tests.TakeIn();
    } else {
      parts.tests.ForgetNewest(input.id);
    }
    throw;
  }
  internal::Remember(current, parts.history);
  internal::FollowBudget(current, decision, counts_loops ? &seen : nullptr, parts);
  decision.retired = internal::RetireIfDue(parts);
  if (parts.options.most_dropped) parts.history.Forget(*parts.options.most_dropped);
  parts.tests.TakeIn();
  parts.map.LimitRobustWidth(std::sqrt(parts.tests.MostInnovation()));
  internal::LogVerdict(decision, parts);
  return decision;
}

template <class Pose>
LinkDecision CompactPoseSlam<Pose>::AddLink(const RelativePoseFactor<Pose>& link) {
  Parts& parts = *parts_;
  const RelativePoseFactor<Pose> carried = CarryToKept(link);
  if (carried.from == carried.to) {
    throw std::invalid_argument("poses " + std::to_string(link.from.value) + " and " + std::to_string(link.to.value) +
                                " hang on the same kept pose");
  }
  Candidate record;
  record.id = carried.from;
  LinkDecision decision;
  decision.from = carried.from;
  decision.to = carried.to;
  const UncertainPose<Pose> known = parts.map.Between(carried.from, carried.to),
                            measured = SeenFrom(carried.from, carried);
  record.measured_gain = InformationGain<Pose::kDof>(known.covariance, measured.covariance);
  decision.accepted = internal::PassesTests<Pose>(nullptr, known, measured, record, parts);
  internal::LogLink(carried.from, carried.to, record, decision.accepted, parts);
  decision.gain = *record.measured_gain;
  decision.innovation = record.innovation;
  decision.outlier = record.outlier;
  if (decision.accepted && parts.options.strategy == Strategy::kBounded) {
    std::vector<internal::NewEdge<Pose>> edges(1);
    edges[0].a = carried.from;
    edges[0].b = carried.to;
    edges[0].T_a_b = measured;
    edges[0].gain = decision.gain;
    std::optional<StepReport> report;
    internal::AddEdges(parts.history.Newest(), edges, parts, report);
    decision.factor = edges[0].id;
  } else if (decision.accepted) {
    GraphUpdate<Pose> update;
    update.factors.push_back(carried);
    decision.factor = parts.map.Update(update).factor_ids.front();
    parts.links.AddLink(carried, {*decision.factor, parts.history.Newest(), decision.gain});
  }
  return decision;
}

template <class Pose>
void CompactPoseSlam<Pose>::RemoveLink(FactorId id) {
  internal::RemoveLink(id, *parts_);
}

template <class Pose>
FactorId CompactPoseSlam<Pose>::AddPrior(const Factor<Pose>& prior) {
  Parts& parts = *parts_;
  GraphUpdate<Pose> update;
  update.factors.push_back(
      internal::CarryPriorToKept(prior, parts.history, parts.map.Solver(), parts.options.composition));
  return parts.map.Update(update).factor_ids.front();
}

template <class Pose>
std::vector<RetiredPose> CompactPoseSlam<Pose>::Retire() {
  return internal::RetireByShare(*parts_);
}

template <class Pose>
std::vector<RetiredPose> CompactPoseSlam<Pose>::Retire(double most_loss) {
  return internal::Retire(most_loss, *parts_);
}

template <class Pose>
BatchResult<Pose> CompactPoseSlam<Pose>::Finish() {
  return parts_->map.Finish();
}

template <class Pose>
RelativePoseFactor<Pose> CompactPoseSlam<Pose>::CarryToKept(const RelativePoseFactor<Pose>& link) const {
  return internal::CarryToKept(link, parts_->history, parts_->options.composition);
}

template <class Pose>
RelativePoseFactor<Pose> CompactPoseSlam<Pose>::CarryEndToKept(PoseId end, const RelativePoseFactor<Pose>& link) const {
  return internal::CarryEndToKept(end, link, parts_->history, parts_->options.composition);
}

template <class Pose>
PoseId CompactPoseSlam<Pose>::KeptBase(PoseId id) const {
  return parts_->history.Find(id).base;
}

template <class Pose>
bool CompactPoseSlam<Pose>::HasSeen(PoseId id) const {
  return parts_->history.Has(id);
}

template <class Pose>
bool CompactPoseSlam<Pose>::HasForgotten(PoseId id) const {
  return parts_->history.IsForgotten(id);
}

template <class Pose>
long CompactPoseSlam<Pose>::PosesForgotten() const {
  return parts_->history.Forgotten();
}

template <class Pose>
PoseId CompactPoseSlam<Pose>::NewerOf(PoseId a, PoseId b) const {
  return parts_->history.NewerOf(a, b);
}

template <class Pose>
int CompactPoseSlam<Pose>::PosesSeen() const {
  return static_cast<int>(parts_->history.Size() + parts_->history.Forgotten());
}

template <class Pose>
int CompactPoseSlam<Pose>::LinksKept() const {
  return parts_->links.Size();
}

template <class Pose>
const IncrementalSolver<Pose>& CompactPoseSlam<Pose>::Solver() const {
  return parts_->map.Solver();
}

template <class Pose>
const CompactOptions<Pose>& CompactPoseSlam<Pose>::Options() const {
  return parts_->options;
}

template <class Pose>
std::vector<RecoveredPose<Pose>> CompactPoseSlam<Pose>::Trajectory(Recovery recovery) const {
  return internal::PoseRecovery<Pose>(parts_->history, parts_->map).Trajectory(recovery);
}

template <class Pose>
Pose CompactPoseSlam<Pose>::Estimate(PoseId id) const {
  return Estimate(id, Recovery::kV1);
}

template <class Pose>
Pose CompactPoseSlam<Pose>::Estimate(PoseId id, Recovery recovery) const {
  return internal::PoseRecovery<Pose>(parts_->history, parts_->map).Estimate(id, recovery);
}

template <class Pose>
typename Pose::Jacobian CompactPoseSlam<Pose>::Covariance(PoseId id, const CovarianceConvention& convention) const {
  return internal::PoseRecovery<Pose>(parts_->history, parts_->map).Covariance(id, convention);
}

template <class Pose>
typename Pose::Jacobian CompactPoseSlam<Pose>::RelativeCovariance(PoseId a, PoseId b,
                                                                  const CovarianceConvention& convention) const {
  return internal::PoseRecovery<Pose>(parts_->history, parts_->map).RelativeCovariance(a, b, convention);
}

template <class Pose>
CompactMap<Pose> CompactPoseSlam<Pose>::Export(Recovery recovery) const {
  return internal::ExportMap(*parts_, recovery);
}

template <class Pose>
CompactPoseSlam<Pose> CompactPoseSlam<Pose>::Restore(const CompactMap<Pose>& map, const CompactOptions<Pose>& options) {
  CompactPoseSlam slam(options);
  internal::RestoreMap(map, *slam.parts_);
  return slam;
}

template <class Pose>
void CompactPoseSlam<Pose>::SetLog(LogSink log) {
  parts_->map.SetLog(log);
  parts_->options.log = std::move(log);
}

template <class Pose>
template <class Archive>
void CompactPoseSlam<Pose>::Serialize(Archive& archive) {
  auto& [parts] = *this;
  archive(*parts);
}

template <class Pose>
void CompactPoseSlam<Pose>::Save(const std::string& path) const {
  SaveState(path, StateKind<Pose>("compact pose SLAM"), *this);
}

template <class Pose>
CompactPoseSlam<Pose> CompactPoseSlam<Pose>::Load(const std::string& path, LogSink log) {
  CompactPoseSlam slam = LoadState<CompactPoseSlam>(path, StateKind<Pose>("compact pose SLAM"));
  slam.SetLog(std::move(log));
  internal::Log(slam.Options().log, LogLevel::kInfo, "restored from ", path, ": ", slam.PosesSeen(), " poses seen, ",
                slam.parts_->map.Poses(), " kept, ", slam.LinksKept(), " links");
  return slam;
}

#define TERSE_INSTANTIATE(Pose)                                 \
  template class CompactPoseSlam<Pose>;                         \
  template void CompactPoseSlam<Pose>::Serialize(StateWriter&); \
  template void CompactPoseSlam<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
