#pragma once
// Where and from what the results come, and the tables made of them.

#include <nlohmann/json.hpp>
#include <string>

namespace terse::bench {

// Processor, cores, commit, compiler, BLAS in use, date.
nlohmann::json Machine();

// Markdown; empty without results.
std::string Tables(const nlohmann::json& results);
std::string CovarianceTables(const nlohmann::json& results);

// Puts the tables between the lines <!-- mark --> and <!-- /mark --> of a file. Throws std::runtime_error.
void UpdateDocument(const std::string& path, const std::string& tables, const std::string& mark = "bench");

}  // namespace terse::bench
