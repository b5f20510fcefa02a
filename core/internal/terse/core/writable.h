#pragma once
// Can results be written there? Asked before a long run, not after it.

#include <string>

namespace terse {

// Throws FileError if no file could be written at this path. Does nothing for "", nor for what is no regular file.
void RequireWritable(const std::string& path);

// Makes the folder if it is missing. Throws FileError, also if `file`, one of those that are to go into it, could not
// be written there.
void RequireFolder(const std::string& path, const std::string& file);

}  // namespace terse
