#pragma once
// Arrays for numpy.load: an uncompressed zip of .npy files.

#include <cstdint>
#include <string>
#include <vector>

namespace terse {

struct NpzArray {
  std::string name;
  std::string type;  // "i8" or "f8"
  std::vector<std::size_t> shape;
  std::string bytes;  // row by row, in the machine's byte order
};
NpzArray MakeNpzArray(const std::string& name, const std::vector<std::int64_t>& numbers);
NpzArray MakeNpzArray(const std::string& name, const std::vector<std::size_t>& shape,
                      const std::vector<double>& numbers);

// Same arrays, same bytes. Throws FileError, also beyond the 4 GiB that a zip can hold.
void WriteNpz(const std::vector<NpzArray>& arrays, const std::string& path);

}  // namespace terse
