#pragma once
// Where and from what the results come, and the tables made of them.

#include <nlohmann/json.hpp>
#include <string>

namespace terse::bench {

// Of each program; bench_main.cpp calls it and reports what it throws.
int Main(int argc, char** argv);

// printf's, of one number.
std::string Format(const char* format, double value);

// Processor, cores, commit, compiler, BLAS in use, date.
nlohmann::json Machine();

// Markdown; empty without results.
std::string Tables(const nlohmann::json& results);
std::string CovarianceTables(const nlohmann::json& results);
// A row of the table of all runs: seconds of the incremental runs, graph by graph; empty where there was none.
std::string HistoryLine(const nlohmann::json& results);

}  // namespace terse::bench
