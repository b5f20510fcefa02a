#include "pose_step.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "carry.h"
#include "chains.h"
#include "revival.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"
#include "terse/core/pose_name.h"

namespace terse::internal {
namespace {

using std::size_t;

template <class Pose>
void CheckPose(const CompactInput<Pose>& input, const PoseHistory<Pose>& history) {
  const std::string name = Name(input.id);
  if (history.Has(input.id)) throw std::invalid_argument(name + " was added already");
  if (history.IsForgotten(input.id)) {
    throw std::invalid_argument(name + " comes after pose " + std::to_string(history.Newest().value) +
                                ", but poses are forgotten, and so ids have to ascend");
  }
  if (input.odometry.has_value() == history.IsEmpty()) {
    throw std::invalid_argument(name + (history.IsEmpty() ? " is the first and has odometry" : " has no odometry"));
  }
  if (input.T_world_body && !std::isfinite(input.T_world_body->Log().sum())) {
    throw std::invalid_argument(name + " has a value that is not finite");
  }
  if (input.fixed && !input.T_world_body && !history.IsEmpty())
    throw std::invalid_argument(name + " is fixed but has no value");
  for (const Factor<Pose>& prior : input.priors) {
    const FactorPoses ends = PosesOf(prior);
    if (ends.count != 1 || ends.first != input.id)
      throw std::invalid_argument("a prior of " + name + " is no prior on it");
    const std::string defect = FindDefect<Pose>(prior);
    if (!defect.empty()) throw std::invalid_argument(defect);
  }
  if (input.loops) {
    for (const RelativePoseFactor<Pose>& loop : *input.loops) {
      const std::string defect = FindDefect<Pose>(loop);
      if (!defect.empty()) throw std::invalid_argument(defect);
      if (loop.from != input.id && loop.to != input.id)
        throw std::invalid_argument("a loop of " + name + " does not touch it");
      const PoseId other = loop.from == input.id ? loop.to : loop.from;
      if (!history.IsForgotten(other)) history.Find(other);
    }
  }
  if (!input.odometry) return;
  const std::string defect = FindDefect<Pose>(*input.odometry);
  if (!defect.empty()) throw std::invalid_argument(defect);
  if (input.odometry->from != input.id && input.odometry->to != input.id)
    throw std::invalid_argument("the odometry does not touch " + name);
}

}  // namespace

template <class Pose>
CurrentPose<Pose> Arrive(const CompactInput<Pose>& input, const CompactParts<Pose>& parts) {
  const PoseHistory<Pose>& history = parts.history;
  CheckPose(input, history);
  CurrentPose<Pose> current;
  current.input = &input;
  if (history.IsEmpty()) {
    current.base = input.id;
    current.T_world_body = input.T_world_body.value_or(Pose());
    return current;
  }
  const RelativePoseFactor<Pose>& edge = *input.odometry;
  const auto& previous = history.Find(edge.from == input.id ? edge.to : edge.from);
  current.previous = current.parent = previous.id;
  const UncertainPose<Pose> odometry = SeenFrom(previous.id, edge);
  current.base = previous.base;
  current.concatenated = !previous.kept;
  current.T_base_current =
      previous.kept ? odometry : Compose(previous.T_base_pose, odometry, parts.options.composition);
  current.chain = current.T_base_current;
  current.T_world_body = parts.map.Solver().Estimate(current.base) * current.T_base_current.T_a_b;
  if (!IsFinite(current.T_world_body) || !current.chain.covariance.allFinite()) {
    throw NumericalError("the odometry of pose " + std::to_string(input.id.value) + " leads beyond all numbers");
  }
  return current;
}

template <class Pose>
std::vector<FactorId> Keep(const std::vector<Factor<Pose>>& links, CurrentPose<Pose>& current,
                           CompactParts<Pose>& parts, const Revival<Pose>* revival) {
  const CompactInput<Pose>& input = *current.input;
  GraphUpdate<Pose> update;
  if (revival != nullptr) AddRevival(*revival, parts, update);
  const size_t revived = update.factors.size();
  if (!current.in_solver) {
    const Pose start = input.fixed ? input.T_world_body.value_or(current.T_world_body) : current.T_world_body;
    update.poses.push_back({input.id, start, input.fixed});
    if (input.odometry && !current.concatenated) {
      update.factors.push_back(*input.odometry);
    } else if (input.odometry) {
      update.factors.push_back(Measurement(current.base, input.id, current.T_base_current, parts.options.composition));
    }
    update.factors.insert(update.factors.end(), input.priors.begin(), input.priors.end());
  }
  const size_t others = update.factors.size();
  update.factors.insert(update.factors.end(), links.begin(), links.end());
  if (update.poses.empty() && update.factors.empty()) return {};
  const StepReport report = parts.map.Update(update);
  Accumulate(report, current.update);
  if (revival != nullptr) Revive(*revival, report.factor_ids, parts);
  if (!current.in_solver && input.odometry) {
    current.odometry = report.factor_ids[revived];
    const FactorPoses ends = PosesOf(update.factors[revived]);
    parts.links.AddOdometry(ends.first, ends.second, current.odometry);
  }
  std::vector<FactorId> ids(report.factor_ids.begin() + static_cast<long>(others), report.factor_ids.end());
  for (size_t k = 0; k < ids.size(); ++k) parts.links.AddLink(links[k], {ids[k], input.id, std::nullopt});
  current.in_solver = true;
  current.concatenated = false;
  current.T_world_body = parts.map.Solver().Estimate(input.id);
  current.base = input.id;
  current.T_base_current = {};
  return ids;
}

void Accumulate(const StepReport& update, std::optional<StepReport>& sum) {
  if (!sum) {
    sum = update;
    return;
  }
  StepReport& s = *sum;
  s.factor_ids.insert(s.factor_ids.end(), update.factor_ids.begin(), update.factor_ids.end());
  s.path = std::max(s.path, update.path);
  s.fronts_updated += update.fronts_updated;
  s.fronts_refactored += update.fronts_refactored;
  s.variables_refactored += update.variables_refactored;
  s.gate_open = s.gate_open || update.gate_open;
  s.gate_value = std::max(s.gate_value, update.gate_value);
  s.iterations += update.iterations;
  s.variables_relinearised += update.variables_relinearised;
  s.variables_moved += update.variables_moved;
  s.predicted_decrease += update.predicted_decrease;
  s.actual_decrease += update.actual_decrease;
  s.gain_nats += update.gain_nats;
  s.restarted = s.restarted || update.restarted;
  s.deferred_relinearisations = update.deferred_relinearisations;
  s.deferred_fronts = update.deferred_fronts;
  s.flops += update.flops;
  s.solve_flops += update.solve_flops;
  s.seconds += update.seconds;
}

template <class Pose>
PoseVerdict Judge(const CurrentPose<Pose>& current, const Decision& decision, const CompactParts<Pose>& parts) {
  const Strategy strategy = parts.options.strategy;
  if (parts.history.IsEmpty()) return PoseVerdict::kFirst;
  if (decision.links_accepted > 0) return PoseVerdict::kLoopClosed;
  if (!current.input->priors.empty() || current.input->fixed) return PoseVerdict::kPrior;
  if (strategy == Strategy::kGiven) return current.input->keep ? PoseVerdict::kGiven : PoseVerdict::kRedundant;
  if (current.is_anchored) return PoseVerdict::kAnchored;
  if (strategy != Strategy::kFpfl && strategy != Strategy::kBounded) return PoseVerdict::kAllKept;
  if (!decision.pose_gain) return PoseVerdict::kNothingInRange;
  return *decision.pose_gain > parts.gains.MinPoseGain() ? PoseVerdict::kInformative : PoseVerdict::kRedundant;
}

template <class Pose>
void Remember(const CurrentPose<Pose>& current, PoseHistory<Pose>& history) {
  typename PoseHistory<Pose>::Seen seen;
  seen.id = seen.base = current.input->id;
  seen.kept = current.in_solver;
  seen.anchored = current.is_anchored;
  seen.odometry = current.odometry;
  seen.T_world_body_when_seen = current.T_world_body;
  if (!seen.kept) {
    seen.base = current.base;
    seen.T_base_pose = current.T_base_current;
  }
  history.Append(seen, current.previous, current.parent);
  if (seen.kept && current.parent) history.EndChain(*current.parent, seen.id, current.chain);
  if (seen.anchored) history.EndChain(*current.previous, seen.base, current.T_ended_base, seen.id);
}

template <class Pose>
SeenLoops<Pose> LoopsOf(const CurrentPose<Pose>& current, const CompactParts<Pose>& parts) {
  const CompactInput<Pose>& input = *current.input;
  SeenLoops<Pose> seen{input.id, current.base, current.T_base_current, {}, {}, {}};
  if (!input.loops) return seen;
  for (const RelativePoseFactor<Pose>& loop : *input.loops) {
    const PoseId other = loop.from == input.id ? loop.to : loop.from;
    if (parts.history.IsForgotten(other)) continue;
    const PoseId kept = parts.history.Find(other).base;
    seen.measured.push_back(
        {kept, SeenFrom(kept, CarryEndToKept(other, loop, parts.history, parts.options.composition))});
  }
  return seen;
}

template <class Pose>
void FollowBudget(const CurrentPose<Pose>& current, const Decision& decision, SeenLoops<Pose>* seen,
                  CompactParts<Pose>& parts) {
  const auto& loops = current.input->loops;
  typename GainControl<Pose>::Kept kept;
  kept.poses = parts.map.Poses();
  kept.links = parts.links.Size();
  kept.new_loops = loops ? static_cast<int>(loops->size()) : decision.registrations_tried;
  kept.loops_used = decision.links_accepted + static_cast<int>(decision.edges.size());
  kept.is_kept = decision.Kept();
  if (seen != nullptr && decision.links_refused == 0) {
    seen->in_range = current.in_range;
    const auto is_link = [&](FactorId id) { return parts.links.Find(id) != nullptr; };
    parts.gains.FollowError(parts.options, *seen, kept, parts.map.Solver(), is_link);
  }
  parts.gains.Follow(parts.options, kept, current.T_world_body);
}

template <class Pose>
void LogVerdict(const Decision& decision, const CompactParts<Pose>& parts) {
  if (!parts.options.log) return;
  const bool by_gain = decision.verdict == PoseVerdict::kInformative || decision.verdict == PoseVerdict::kRedundant;
  const LogLevel level =
      decision.Kept() && decision.verdict != PoseVerdict::kAllKept ? LogLevel::kInfo : LogLevel::kDebug;
  const std::string name = Name(decision.id) + (decision.Kept() ? " kept, " : " dropped, ");
  if (by_gain && decision.pose_gain) {
    Log(parts.options.log, level, name, Name(decision.verdict), ": gain ", *decision.pose_gain, " nats (threshold ",
        parts.gains.MinPoseGain(), "), ", decision.candidates.size(), " candidates");
  } else {
    Log(parts.options.log, level, name, Name(decision.verdict), ": ", decision.candidates.size(), " candidates, ",
        decision.registrations_tried, " tried, ", decision.links_accepted, " links, ", decision.links_refused,
        " refused");
  }
}

#define TERSE_INSTANTIATE(Pose)                                                                                  \
  template CurrentPose<Pose> Arrive(const CompactInput<Pose>&, const CompactParts<Pose>&);                       \
  template std::vector<FactorId> Keep(const std::vector<Factor<Pose>>&, CurrentPose<Pose>&, CompactParts<Pose>&, \
                                      const Revival<Pose>*);                                                     \
  template PoseVerdict Judge(const CurrentPose<Pose>&, const Decision&, const CompactParts<Pose>&);              \
  template void Remember(const CurrentPose<Pose>&, PoseHistory<Pose>&);                                          \
  template SeenLoops<Pose> LoopsOf(const CurrentPose<Pose>&, const CompactParts<Pose>&);                         \
  template void FollowBudget(const CurrentPose<Pose>&, const Decision&, SeenLoops<Pose>*, CompactParts<Pose>&);  \
  template void LogVerdict(const Decision&, const CompactParts<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
