#include "commands/policy.h"

namespace terse {
namespace {

template <class Value>
std::string NameIn(const std::vector<std::pair<std::string, Value>>& names, Value value) {
  for (const auto& [name, named] : names) {
    if (named == value) return name;
  }
  return "";
}

}  // namespace

const std::vector<std::pair<std::string, Policy>>& PolicyNames() {
  static const std::vector<std::pair<std::string, Policy>> names = {
      {"default", Policy::kDefault},
      {"gn1", Policy::kGn1},
      {"gni", Policy::kGni},
      {"gni-lcg", Policy::kGniLcg},
      {"gni-igg", Policy::kGniIgg},
      {"gni-spo", Policy::kGniSpo},
      {"gni-spo-lcg", Policy::kGniSpoLcg},
      {"gni-spo-igg", Policy::kGniSpoIgg},
  };
  return names;
}

const std::vector<std::pair<std::string, Gate>>& GateNames() {
  static const std::vector<std::pair<std::string, Gate>> names = {
      {"newton_decrement", Gate::kNewtonDecrement},
      {"mutual_information", Gate::kMutualInformation},
      {"log_determinant", Gate::kLogDeterminant},
      {"loop_closure", Gate::kLoopClosure},
      {"always", Gate::kAlways},
      {"never", Gate::kNever},
  };
  return names;
}

const std::vector<std::pair<std::string, RobustKernel>>& KernelNames() {
  static const std::vector<std::pair<std::string, RobustKernel>> names = {
      {"none", RobustKernel::kNone},   {"huber", RobustKernel::kHuber}, {"cauchy", RobustKernel::kCauchy},
      {"tukey", RobustKernel::kTukey}, {"dcs", RobustKernel::kDcs},     {"gnc", RobustKernel::kGnc},
  };
  return names;
}

std::string Name(Policy policy) { return NameIn(PolicyNames(), policy); }
std::string Name(RobustKernel kernel) { return NameIn(KernelNames(), kernel); }

}  // namespace terse
