#pragma once
// Tables within documents, between marks.

#include <string>

namespace terse {

// Replaces what is between the lines <!-- mark --> and <!-- /mark --> of a document. Throws FileError if it cannot be
// read or has no such place.
// RequirePlace: that alone, before a long run.
void RequirePlace(const std::string& path, const std::string& mark);
void UpdateDocument(const std::string& path, const std::string& text, const std::string& mark);
// Adds lines at the end of that place.
void AppendToDocument(const std::string& path, const std::string& lines, const std::string& mark);

}  // namespace terse
