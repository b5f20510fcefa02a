#pragma once
// Random numbers that are the same everywhere: SplitMix64, and hashes of several numbers.

#include <cstdint>

namespace terse {

inline std::uint64_t HashMix(std::uint64_t x) {
  x += 0x9e3779b97f4a7c15u;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
  return x ^ (x >> 31);
}
template <class... More>
std::uint64_t HashMix(std::uint64_t x, More... more) {
  return HashMix(x ^ (0x632be59bd9b4e019u * HashMix(static_cast<std::uint64_t>(more)...)));
}

class StreetRandom {
 public:
  explicit StreetRandom(std::uint64_t seed) : state_(seed) {}
  std::uint64_t Bits() {
    const std::uint64_t bits = HashMix(state_);
    state_ += 0x9e3779b97f4a7c15u;
    return bits;
  }
  double Uniform(double low, double high) { return low + (high - low) * static_cast<double>(Bits() >> 11) * 0x1p-53; }
  int Integer(int low, int high) {  // both included
    return low + static_cast<int>(Bits() % static_cast<std::uint64_t>(high - low + 1));
  }
  bool Chance(double probability) { return Uniform(0, 1) < probability; }

 private:
  std::uint64_t state_;
};

}  // namespace terse
