#pragma once
// -v and -vv: what the library says about its work (terse/core/log.h), on standard error.

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "terse/core/log.h"

namespace terse {

// For every subcommand that computes; call it when --quiet is there, which excludes it. The sink stays empty without
// the option.
void AddVerboseOption(CLI::App& subcommand, LogSink& log);

}  // namespace terse
