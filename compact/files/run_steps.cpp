#include "terse/compact/run_steps.h"

#include <algorithm>

#include "terse/core/atomic_file.h"
#include "terse/core/evaluate.h"
#include "terse/core/number_text.h"
#include "terse/core/stamped_trajectory.h"

namespace terse {
namespace {

constexpr int kSamples = 300, kErrorSamples = 100;

template <class Value>
std::string OrEmpty(const std::optional<Value>& value) {
  return value ? std::to_string(static_cast<long long>(*value)) : "";
}
std::string OrEmpty(const std::optional<double>& value) { return value ? Shortest(*value) : ""; }

}  // namespace

template <class Pose>
StepRecorder<Pose>::StepRecorder(int steps, const TruePoses* truth)
    : expected_(steps), stride_(std::max(1, steps / kSamples)), truth_(truth) {}

template <class Pose>
void StepRecorder<Pose>::Add(const CompactPoseSlam<Pose>& slam, const Decision& decision, double seconds) {
  CompactStep step;
  step.pose = decision.id;
  step.poses = static_cast<int>(slam.Solver().Graph().Poses().size());
  step.links = slam.LinksKept();
  step.seconds = seconds;
  for (const Candidate& candidate : decision.candidates) {
    if (!candidate.accepted || !candidate.measured_gain) continue;
    step.gain = std::max(step.gain.value_or(*candidate.measured_gain), *candidate.measured_gain);
  }
  if (decision.update) {
    step.gate_open = decision.update->gate_open;
    step.gate_value = decision.update->gate_value;
  }
  DropForgotten(slam);
  const int number = ++added_;
  const bool is_last = number == expected_;
  if (number % stride_ == 0 || is_last) {
    step.hessian_nonzeros = HessianNonzeros(slam.Solver().Graph());
    step.factor_nonzeros = slam.Solver().Cholesky().Nonzeros();
  }
  if (truth_ != nullptr && (number % std::max(1, expected_ / kErrorSamples) == 0 || is_last)) step.ate_m = Ate(slam);
  steps_.push_back(step);
}

// Counted as its factors come in.
template <class Pose>
std::int64_t StepRecorder<Pose>::HessianNonzeros(const PoseGraph<Pose>& graph) {
  constexpr std::int64_t B = Pose::kDof;
  for (; counted_ < graph.Factors().size(); ++counted_) {
    const FactorPoses ends = PosesOf(graph.Factors()[counted_].factor);
    if (ends.count == 2) pairs_.insert(std::minmax(ends.first.value, ends.second.value));
  }
  return B * (B + 1) / 2 * static_cast<std::int64_t>(graph.Poses().size()) +
         B * B * static_cast<std::int64_t>(pairs_.size());
}

template <class Pose>
void StepRecorder<Pose>::DropForgotten(const CompactPoseSlam<Pose>& slam) {
  if (slam.PosesForgotten() == forgotten_) return;
  forgotten_ = slam.PosesForgotten();
  const auto is_forgotten = [&](const CompactStep& step) { return !slam.HasSeen(step.pose); };
  steps_.erase(std::remove_if(steps_.begin(), steps_.end(), is_forgotten), steps_.end());
  true_.clear();
}

// Of all poses remembered, as they are known now: dropped ones by their chains.
template <class Pose>
std::optional<double> StepRecorder<Pose>::Ate(const CompactPoseSlam<Pose>& slam) {
  const std::vector<RecoveredPose<Pose>> trajectory = slam.Trajectory(Recovery::kV1);
  if (trajectory.size() < 2) return std::nullopt;
  for (std::size_t k = true_.size(); k < trajectory.size(); ++k) true_.push_back(truth_->at(trajectory[k].id.value));
  std::vector<SE3> estimate;
  estimate.reserve(trajectory.size());
  for (const auto& pose : trajectory) estimate.push_back(InSpace(pose.T_world_body));
  return AbsoluteError(estimate, true_, Pose::kDim == 2 ? Alignment::kSE2 : Alignment::kSE3);
}

void WriteCompactSteps(const std::vector<CompactStep>& steps, const std::string& earlier, const std::string& path) {
  AtomicFile file(path);
  std::ostream& out = file.Stream();
  out << "pose,poses,links,gain_nats,gate_open,gate_value,seconds,hessian_nonzeros,factor_nonzeros,ate_m\n" << earlier;
  for (const CompactStep& s : steps) {
    out << s.pose.value << ',' << s.poses << ',' << s.links << ',' << OrEmpty(s.gain) << ',' << OrEmpty(s.gate_open)
        << ',' << OrEmpty(s.gate_value) << ',' << Shortest(s.seconds) << ',' << OrEmpty(s.hessian_nonzeros) << ','
        << OrEmpty(s.factor_nonzeros) << ',' << OrEmpty(s.ate_m) << '\n';
  }
  file.Commit();
}

template class StepRecorder<SE2>;
template class StepRecorder<SE3>;

}  // namespace terse
