#include "commands/start.h"

#include "terse/core/start_values.h"

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

template <class Pose>
std::vector<Pose> StartValues(const PoseGraph<Pose>& graph, InitialValues method, const BatchOptions& options,
                              nlohmann::ordered_json& stats) {
  const bool automatic = method == InitialValues::kAuto;
  // Loops that may be wrong bend a relaxation; odometry does not know them.
  const bool compare = automatic && options.robust.kernel == RobustKernel::kNone && !graph.Poses().empty();
  if (!compare) {
    if (automatic) method = InitialValues::kCompose;
    stats["initial"] = {{"method", Name(method)}, {"chosen_by", automatic ? "auto" : "option"}};
    return ComputeInitialValues(graph, method);
  }
  StartChoice<Pose> choice = ChooseStart(graph, {options.threads, options.log});
  nlohmann::ordered_json compared = nlohmann::ordered_json::array();
  for (const StartTrial& trial : choice.trials) compared.push_back(ToJson(trial));
  stats["initial"] = {{"method", Name(choice.chosen)}, {"chosen_by", "auto"}, {"compared", compared}};
  return std::move(choice.T_world_body);
}

#define TERSE_INSTANTIATE(Pose)                                                                            \
  template std::vector<Pose> StartValues<Pose>(const PoseGraph<Pose>&, InitialValues, const BatchOptions&, \
                                               nlohmann::ordered_json&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
