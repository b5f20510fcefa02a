#include "incremental/loop_selection.h"

#include <stdexcept>

#include "terse/core/error.h"
#include "terse/core/log_message.h"
#include "terse/core/replay.h"

namespace terse::internal {

// Between two looks at whether the caller wants to go on.
constexpr int kStepsBetweenProgress = 100;

template <class Pose>
std::optional<LoopSelection<Pose>> SolveByReplay(const PoseGraph<Pose>& graph, const BatchOptions& options,
                                                 bool& is_stopped) {
  IncrementalOptions incremental;
  incremental.robust = options.robust;
  incremental.threads = options.threads;
  incremental.log = options.log;
  IncrementalSolver<Pose> solver(incremental);
  try {
    Replay<Pose>(graph, ReplayOptions(), solver, [&](const ReplayStep& step) {
      const bool asks = options.progress && (step.index + 1) % kStepsBetweenProgress == 0;
      is_stopped = asks && !options.progress(0, solver.Chi2());
      return !is_stopped;
    });
    if (is_stopped) return std::nullopt;
    BatchOptions finish = options;
    finish.robust_factors.reset();
    BatchResult<Pose> result = solver.Finish(finish);
    OrderAsIn(graph, ArrivalUnit::kPose, solver.Graph(), result);
    LoopSelection<Pose> selection{std::move(result.T_world_body), LoopFactors(graph), result.robust_width};
    for (const FactorId id : SlippedOdometry(graph, result.weights)) selection.robust_factors.push_back(id);
    return selection;
  } catch (const NumericalError& error) {
    Log(options.log, LogLevel::kInfo, "batch: no replay, ", error.what());
  } catch (const std::invalid_argument& error) {
    Log(options.log, LogLevel::kInfo, "batch: no replay, ", error.what());
  }
  return std::nullopt;
}

#define TERSE_INSTANTIATE(Pose) \
  template std::optional<LoopSelection<Pose>> SolveByReplay<Pose>(const PoseGraph<Pose>&, const BatchOptions&, bool&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
