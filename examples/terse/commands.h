#pragma once
// The subcommands. Each function adds one to the application; its work runs as the subcommand's callback and throws
// terse::FileError, std::invalid_argument or terse::NumericalError, which main() turns into exit codes.

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>
#include <nlohmann/json.hpp>

#include "terse/core/graph_file.h"

namespace terse {

void AddInfoCommand(CLI::App& app);
void AddConvertCommand(CLI::App& app);
void AddEvaluateCommand(CLI::App& app);
void AddGenerateCommand(CLI::App& app);

// --rotation-information and --repair-information, for every subcommand that reads a graph.
void AddReadOptions(CLI::App& subcommand, ReadOptions& options);

// Indented, on standard output. Numbers that are not finite become null.
void PrintJson(const nlohmann::ordered_json& json);

// Flushes standard output; FileError if it cannot take the text (a full disk).
void FlushOutput();

// The name nearest to a mistyped one by edit distance, or "" if none is near.
std::string NearestName(const std::string& mistyped, const std::vector<std::string>& names);

}  // namespace terse
