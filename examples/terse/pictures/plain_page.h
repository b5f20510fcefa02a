#pragma once
// Pages of numbers and pictures that need nothing else: of sparsify and merge.

#include <string>

namespace terse {

// `body`: HTML. Written whole or not at all. Throws FileError.
void WritePlainPage(const std::string& title, const std::string& body, const std::string& path);

}  // namespace terse
