#include "terse/core/incremental_options.h"

#include <cmath>

namespace terse {

double DefaultThreshold(Gate gate) {
  switch (gate) {
    case Gate::kNewtonDecrement: return 1e-5;
    case Gate::kMutualInformation: return 0.1;
    case Gate::kLogDeterminant: return 1;
    case Gate::kLoopClosure: return 4;
    case Gate::kAlways:
    case Gate::kNever: break;
  }
  return 0;
}

std::string FindDefect(const IncrementalOptions& options) {
  const auto is_size = [](double x) { return std::isfinite(x) && x >= 0; };
  if (std::isnan(options.gate_threshold)) return "the gate's threshold is not a number";
  if (!is_size(options.relinearize_tolerance) || !is_size(options.relinearize_metres) ||
      !is_size(options.relinearize_radians) || !is_size(options.step_metres) || !is_size(options.step_radians) ||
      !is_size(options.propagation_tolerance) || !is_size(options.reweigh_tolerance)) {
    return "tolerances must not be negative";
  }
  if (options.relinearize_interval < 1) return "the relinearisation interval must be at least 1";
  if (options.max_iterations < 1) return "at least one iteration is needed";
  if (options.threads < 1) return "at least one thread is needed";
  if (!is_size(options.budget_seconds)) return "the budget must not be negative";
  if (options.anchor_information && !(*options.anchor_information > 0)) return "the anchor must be positive";
  return FindDefect(options.robust);
}

IncrementalOptions PolicyOptions(Policy policy) {
  IncrementalOptions options;
  if (policy == Policy::kDefault) return options;
  options.carry = Carry::kPoint;
  options.propagation_tolerance = 0;
  options.partial_neighbours = false;
  options.guard = false;
  options.anchor_information = 1;
  options.gate = Gate::kAlways;
  options.max_iterations = policy == Policy::kGn1 ? 1 : 10;
  switch (policy) {
    case Policy::kGniLcg:
    case Policy::kGniSpoLcg: options.gate = Gate::kLoopClosure; break;
    case Policy::kGniIgg:
    case Policy::kGniSpoIgg: options.gate = Gate::kLogDeterminant; break;
    default: break;
  }
  options.gate_threshold = DefaultThreshold(options.gate);
  options.partial = policy == Policy::kGniSpo || policy == Policy::kGniSpoLcg || policy == Policy::kGniSpoIgg;
  return options;
}

}  // namespace terse
