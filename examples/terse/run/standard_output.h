#pragma once
// What goes to standard output.

#include <nlohmann/json.hpp>

namespace terse {

// Indented. Numbers that are not finite become null. Throws FileError.
void PrintJson(const nlohmann::ordered_json& json);

// Flushes; FileError if standard output cannot take the text (a full disk).
void FlushOutput();

}  // namespace terse
