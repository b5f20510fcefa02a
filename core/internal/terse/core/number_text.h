#pragma once
// Numbers as text, whatever the locale.

#include <string>

namespace terse {

// The shortest decimal text that reads back as the same double ("nan" and "inf" as such), whatever the locale.
std::string Shortest(double value);

// Six digits, for a message.
std::string SixDigits(double value);

}  // namespace terse
