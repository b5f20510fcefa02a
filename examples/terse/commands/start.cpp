#include "commands/start.h"

#include "terse/core/elimination_order.h"

namespace terse {
namespace {

nlohmann::ordered_json ToJson(const StartTrial& trial) {
  nlohmann::ordered_json out = {{"method", Name(trial.method)}};
  if (!trial.unavailable.empty()) {
    out["unavailable"] = trial.unavailable;
    return out;
  }
  out["cost_at_start"] = trial.cost_at_start;
  out["cost"] = trial.cost;
  out["iterations"] = trial.iterations;
  if (trial.same) out["same_as"] = Name(*trial.same);
  return out;
}

}  // namespace

void DescribeStart(InitialValues chosen, bool is_automatic, const std::vector<StartTrial>& trials,
                   nlohmann::ordered_json& stats) {
  stats["initial"] = {{"method", Name(chosen)}, {"chosen_by", is_automatic ? "auto" : "option"}};
  for (const StartTrial& trial : trials) stats["initial"]["compared"].push_back(ToJson(trial));
}

template <class Pose>
std::vector<Pose> StartValues(const PoseGraph<Pose>& graph, InitialValues method, BatchOptions& options,
                              nlohmann::ordered_json& stats) {
  const bool automatic = method == InitialValues::kAuto;
  StartOptions start_options{options.threads, options.log, options.factor_progress, {}, options.most_factor_bytes};
  if (method == InitialValues::kChordal) start_options.order = options.order = EliminationOrder(graph);
  StartChoice<Pose> start = automatic
                                ? StartFor(graph, options)
                                : StartChoice<Pose>{method, ComputeInitialValues(graph, method, start_options), {}, {}};
  if (automatic) options.order = std::move(start.order);
  DescribeStart(start.chosen, automatic, start.trials, stats);
  return std::move(start.T_world_body);
}

#define TERSE_INSTANTIATE(Pose)                                                                      \
  template std::vector<Pose> StartValues<Pose>(const PoseGraph<Pose>&, InitialValues, BatchOptions&, \
                                               nlohmann::ordered_json&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
