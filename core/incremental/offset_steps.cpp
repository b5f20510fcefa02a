// Carry::kOffset: estimate = linearisation point + d.

#include "incremental/steps.h"
#include "support/stopwatch.h"

namespace terse::internal {

template <class Pose>
bool OptimizeOffsets(bool was_deferred, StepContext<Pose>& step) {
  using Clock = std::chrono::steady_clock;
  const auto& [options, map, relinearization, report, settled, start] = step;
  std::optional<Clock::time_point> deadline;
  if (options.budget_seconds > 0) {
    deadline =
        start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(options.budget_seconds));
  }
  if (relinearization.IsDue(map, options) || was_deferred) {
    relinearization.MoveWorst(false, deadline, map, options, report);
  }
  do {
    BackSubstitute(deadline, step);
    ++report.iterations;
  } while (report.iterations < options.max_iterations && relinearization.IsUrgent(map, options) &&
           !(deadline && Clock::now() > *deadline) && relinearization.MoveWorst(true, deadline, map, options, report));
  report.deferred_fronts = map.Cholesky().LastSolve().deferred;
  return report.deferred_fronts > 0 || report.deferred_relinearisations > 0;
}

template <class Pose>
void BackSubstitute(std::optional<std::chrono::steady_clock::time_point> deadline, StepContext<Pose>& step) {
  LinearizedGraph<Pose>& map = step.map;
  ScopedTimer timer(map.Seconds().solve);
  const double threshold = step.options.propagation_tolerance * map.CostUnit();
  step.relinearization.NoteMoved(map.Solve(threshold, deadline, step.report), map, step.options);
}

template <class Pose>
bool MoveMap(const std::vector<Pose>& T_world_body, StepContext<Pose>& step) {
  Gauge<Pose> gauge = step.map.Frame().gauge;
  if (!step.options.anchor_information) gauge = FindGauge(step.map.Graph(), T_world_body);
  if (!step.map.MoveTo(T_world_body, gauge)) return false;
  step.relinearization.ForgetErrors();
  if (step.options.carry == Carry::kOffset) BackSubstitute(std::nullopt, step);
  return true;
}

#define TERSE_INSTANTIATE(Pose)                                        \
  template bool MoveMap(const std::vector<Pose>&, StepContext<Pose>&); \
  template bool OptimizeOffsets(bool, StepContext<Pose>&);             \
  template void BackSubstitute(std::optional<std::chrono::steady_clock::time_point>, StepContext<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
