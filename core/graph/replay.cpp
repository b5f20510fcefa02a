#include "terse/core/replay.h"

#include <utility>

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

template <class Pose>
void OrderAsIn(const PoseGraph<Pose>& graph, ArrivalUnit every, const PoseGraph<Pose>& arrived,
               BatchResult<Pose>& result) {
  std::vector<Pose> values;
  for (const auto& node : graph.Poses()) {
    values.push_back(result.T_world_body[static_cast<std::size_t>(arrived.IndexOf(node.id))]);
  }
  result.T_world_body = std::move(values);
  if (result.weights.empty()) return;
  const std::vector<double> weights = std::exchange(result.weights, std::vector<double>(graph.Factors().size(), 1.0));
  auto weight = weights.begin();
  for (const ArrivalStep& step : ArrivalSteps(graph, every)) {
    for (const int f : step.factors) result.weights[static_cast<std::size_t>(f)] = *weight++;
  }
}

#define TERSE_INSTANTIATE(Pose)                                                                      \
  template void Replay<Pose>(const PoseGraph<Pose>&, const ReplayOptions&, IncrementalSolver<Pose>&, \
                             const std::function<bool(const ReplayStep&)>&);                         \
  template void OrderAsIn<Pose>(const PoseGraph<Pose>&, ArrivalUnit, const PoseGraph<Pose>&, BatchResult<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
