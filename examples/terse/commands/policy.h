#pragma once
// How an incremental run re-optimises and what loops cost, by name.

#include <string>
#include <utility>
#include <vector>

#include "terse/core/incremental_options.h"

namespace terse {

const std::vector<std::pair<std::string, Policy>>& PolicyNames();
const std::vector<std::pair<std::string, Gate>>& GateNames();
const std::vector<std::pair<std::string, RobustKernel>>& KernelNames();
std::string Name(Policy policy);
std::string Name(RobustKernel kernel);

}  // namespace terse
