#pragma once
// Damage to text as it happens and as it is made: lines and fields lost, doubled, swapped and moved, numbers that are
// extreme, bits flipped, an end that is missing. The same generator and text give the same damage.

#include <random>
#include <string>

namespace terse::fuzz {

// One change. Fields are what blanks, line ends, commas, colons, brackets and quotes part.
std::string MutateText(std::string text, std::mt19937_64& random);

}  // namespace terse::fuzz
