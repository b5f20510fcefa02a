#pragma once
// In which convention covariances are asked for.

#include <CLI/App.hpp>
#include <vector>

#include "terse/covariance/convention.h"

namespace terse {

// --frame and --order.
std::vector<CLI::Option*> AddConventionOptions(CLI::App& subcommand, CovarianceConvention& convention);

}  // namespace terse
