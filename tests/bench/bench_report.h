#pragma once
// Where and from what the results come, and the tables made of them.

#include <nlohmann/json.hpp>
#include <string>

namespace terse::bench {

// Processor, cores, commit, compiler, BLAS in use, date.
nlohmann::json Machine();

// Markdown.
std::string Tables(const nlohmann::json& results);

// Puts the tables between the lines <!-- bench --> and <!-- /bench --> of a file. Throws std::runtime_error.
void UpdateDocument(const std::string& path, const std::string& tables);

}  // namespace terse::bench
