#pragma once
// Random numbers that are the same everywhere.

#include <cstdint>
#include <random>

namespace terse::internal {

// The engine's stream is fixed by the standard; the distributions of <random> are not, so here are our own.
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  // In [0, 1), 53 bits.
  double Uniform() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  // Marsaglia's polar method.
  double Normal();

 private:
  std::mt19937_64 engine_;
  double spare_ = 0;
  bool has_spare_ = false;
};

}  // namespace terse::internal
