#include "terse/core/replay.h"

#include "terse/core/initial_values.h"

namespace terse {

template <class Pose>
void Replay(const PoseGraph<Pose>& graph, const ReplayOptions& options, IncrementalSolver<Pose>& solver,
            const std::function<bool(const ReplayStep&)>& after_step) {
  if (options.stored_values) ComputeInitialValues(graph, InitialValues::kFile);  // throws if one is missing
  const std::vector<ArrivalStep> steps = ArrivalSteps(graph, options.every);
  for (std::size_t k = 0; k < steps.size(); ++k) {
    ReplayStep step;
    step.index = static_cast<int>(k);
    step.steps = static_cast<int>(steps.size());
    GraphUpdate<Pose> update;
    for (const int p : steps[k].poses) {
      const auto& node = graph.Poses()[static_cast<std::size_t>(p)];
      const bool first = solver.Graph().Poses().empty() && update.poses.empty();
      const bool use_value = node.T_world_body && (first || node.fixed || options.stored_values);
      update.poses.push_back({node.id, use_value ? node.T_world_body : std::nullopt, node.fixed && use_value});
    }
    for (const int f : steps[k].factors) {
      update.factors.push_back(graph.Factors()[static_cast<std::size_t>(f)].factor);
    }
    step.report = solver.Update(update);
    if (after_step && !after_step(step)) return;
  }
}

template void Replay<SE2>(const PoseGraph<SE2>&, const ReplayOptions&, IncrementalSolver<SE2>&,
                          const std::function<bool(const ReplayStep&)>&);
template void Replay<SE3>(const PoseGraph<SE3>&, const ReplayOptions&, IncrementalSolver<SE3>&,
                          const std::function<bool(const ReplayStep&)>&);

}  // namespace terse
