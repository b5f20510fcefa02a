// Carry::kOffset: estimate = linearisation point + d.

#include <algorithm>

#include "incremental/steps.h"
#include "support/stopwatch.h"

namespace terse::internal {
namespace {
constexpr double kReserve = 1.5;  // times what back-substitution took of late
constexpr int kMostUnfinished = 10;
}  // namespace

template <class Pose>
bool OptimizeOffsets(int new_poses, bool was_deferred, StepContext<Pose>& step) {
  using Clock = std::chrono::steady_clock;
  const auto& [options, map, relinearization, report, settled, start] = step;
  std::optional<Clock::time_point> deadline;
  const auto seconds = [](double s) {
    return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(s));
  };
  if (options.budget_seconds > 0 &&
      !Relinearization<Pose>::IsQuick(map, options.budget_seconds, options.max_iterations)) {
    deadline = start + seconds(options.budget_seconds);
  }
  // Leaves time for back-substitution.
  const auto for_points = [&, &options = step.options, &relinearization = step.relinearization] {
    std::optional<Clock::time_point> until = deadline;
    const double reserve = std::min(kReserve * relinearization.SolveSeconds(), options.budget_seconds / 2);
    if (until) *until -= seconds(reserve);
    return until;
  };
  // Estimates that back-substitution has half done are not looked at.
  const bool has_to_wait = map.Cholesky().LastSolve().deferred > 0;
  if (!has_to_wait && (relinearization.IsDue(map, options) || was_deferred)) {
    const bool has_moved = relinearization.MoveWorst(false, for_points(), map, options, report);
    const bool has_news =
        has_moved || options.gate != Gate::kNewtonDecrement || report.gate_value > options.gate_threshold;
    // While points are made ready, a step that the gate would have left alone costs no more than that.
    if (report.deferred_relinearisations > 0 && !has_news) {
      ScopedTimer timer(map.Seconds().solve);
      map.PlaceNewPoses(new_poses, report);
      return true;
    }
  }
  do {
    BackSubstitute(deadline, step);
    step.relinearization.NoteNew(true, step.map, options);
    ++report.iterations;
  } while (report.iterations < options.max_iterations && relinearization.IsUrgent(map, options) &&
           map.Cholesky().LastSolve().deferred == 0 && !(deadline && Clock::now() > *for_points()) &&
           relinearization.MoveWorst(true, for_points(), map, options, report));
  report.deferred_fronts = map.Cholesky().LastSolve().deferred;
  if (has_to_wait) report.deferred_relinearisations = relinearization.Unseen();
  return report.deferred_fronts > 0 || report.deferred_relinearisations > 0;
}

template <class Pose>
void BackSubstitute(std::optional<std::chrono::steady_clock::time_point> deadline, StepContext<Pose>& step) {
  LinearizedGraph<Pose>& map = step.map;
  ScopedTimer timer(map.Seconds().solve);
  const double threshold = step.options.propagation_tolerance * map.CostUnit();
  const auto start = std::chrono::steady_clock::now();
  // A map that is never solved to the end would never be relinearised.
  if (step.relinearization.UnfinishedSolves() >= kMostUnfinished) deadline.reset();
  step.relinearization.NoteMoved(map.Solve(threshold, deadline, step.report), map, step.options);
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  step.relinearization.NoteSolved(seconds, map.Cholesky().LastSolve().deferred == 0);
}

template <class Pose>
bool MoveMap(const std::vector<Pose>& T_world_body, StepContext<Pose>& step) {
  Gauge<Pose> gauge = step.map.Frame().gauge;
  if (!step.options.anchor_information) gauge = FindGauge(step.map.Graph(), T_world_body);
  if (!step.map.MoveTo(T_world_body, gauge)) return false;
  step.relinearization.ForgetErrors(step.map);
  if (step.options.carry == Carry::kOffset) BackSubstitute(std::nullopt, step);
  return true;
}

#define TERSE_INSTANTIATE(Pose)                                        \
  template bool MoveMap(const std::vector<Pose>&, StepContext<Pose>&); \
  template bool OptimizeOffsets(int, bool, StepContext<Pose>&);        \
  template void BackSubstitute(std::optional<std::chrono::steady_clock::time_point>, StepContext<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
