// Loops that odometry alone contradicts: what LoopJudge makes of cycle_test.h.

#include <algorithm>
#include <variant>

#include "incremental/loop_judge.h"

namespace terse::internal {

using std::size_t;

template <class Pose>
void LoopJudge<Pose>::NoteCycles(const UpdatePlan<Pose>& plan, const StepContext<Pose>& step) {
  if (!Adapts()) return;
  const auto visit = [&](bool loops, const auto& note) {
    for (size_t k = 0; k < plan.is_loop.size(); ++k) {
      const auto& factor = step.map.Graph().FindFactor(step.report.factor_ids[k])->factor;
      const auto* relative = std::get_if<RelativePoseFactor<Pose>>(&factor);
      if (relative != nullptr && plan.IsLoop(k) == loops) note(*relative);
    }
  };
  visit(false, [&](const RelativePoseFactor<Pose>& odometry) { cycles_.Extend(odometry); });
  visit(true, [&](const RelativePoseFactor<Pose>& loop) {
    if (const auto innovation = cycles_.Innovation(loop)) cycles_.Note(*innovation, stated_limit_);
  });
  SetLimit();
  cycles_.Forget([&](PoseId id) { return step.map.Graph().HasPose(id); });
}

template <class Pose>
bool LoopJudge<Pose>::IsRefusedByOdometry(FactorId id, const Map& map) const {
  if (!Adapts() || !cycles_.IsActive() || IsSlip(id)) return false;
  const auto* loop = std::get_if<RelativePoseFactor<Pose>>(&map.Graph().FindFactor(id)->factor);
  return loop != nullptr && cycles_.Refuses(cycles_.Innovation(*loop));
}

// When much more is known of the odometry than at the last time.
template <class Pose>
bool LoopJudge<Pose>::DropIfRefused(StepContext<Pose>& step) {
  reviewed_cycle_limit_ = std::max(reviewed_cycle_limit_, cycles_.Limit());
  return cycles_.Limit() * kNews <= reviewed_cycle_limit_ && DropRefused(step);
}

template <class Pose>
bool LoopJudge<Pose>::DropRefused(StepContext<Pose>& step) {
  if (!Adapts() || !cycles_.IsActive()) return false;
  reviewed_cycle_limit_ = cycles_.Limit();
  Loops refused;
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (!slots_[slot].is_loop) continue;
    const FactorId id = step.map.IdAt(static_cast<int>(slot));
    if (IsRefusedByOdometry(id, step.map)) refused.emplace_back(id, step.map);
  }
  return !refused.empty() && Exchange({}, refused, step);
}

#define TERSE_INSTANTIATE(Pose)                                                                 \
  template void LoopJudge<Pose>::NoteCycles(const UpdatePlan<Pose>&, const StepContext<Pose>&); \
  template bool LoopJudge<Pose>::IsRefusedByOdometry(FactorId, const Map&) const;               \
  template bool LoopJudge<Pose>::DropIfRefused(StepContext<Pose>&);                             \
  template bool LoopJudge<Pose>::DropRefused(StepContext<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
