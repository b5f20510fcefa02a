#pragma once
// How an incremental run re-optimises, by name.

#include <string>
#include <utility>
#include <vector>

#include "terse/core/incremental_options.h"

namespace terse {

const std::vector<std::pair<std::string, Policy>>& PolicyNames();
const std::vector<std::pair<std::string, Gate>>& GateNames();
std::string Name(Policy policy);

}  // namespace terse
