#include "descriptor_matching.h"

#include <algorithm>
#include <cmath>

namespace terse {
namespace {

using std::size_t;

constexpr float kSamePlace = 6;  // pixels: the same corner on another level

// Debian's baseline has no instruction for it, every machine of today has.
#if defined(__x86_64__) && defined(__GNUC__)
#define TERSE_POPCOUNT __attribute__((target("popcnt")))
bool HasPopcount() { return __builtin_cpu_supports("popcnt") != 0; }
#else
#define TERSE_POPCOUNT
bool HasPopcount() { return true; }
#endif

TERSE_POPCOUNT void RowByInstruction(const BinaryDescriptor& a, const std::vector<BinaryDescriptor>& b, int* out) {
  for (const BinaryDescriptor& d : b) {
    *out++ = __builtin_popcountll(a[0] ^ d[0]) + __builtin_popcountll(a[1] ^ d[1]) + __builtin_popcountll(a[2] ^ d[2]) +
             __builtin_popcountll(a[3] ^ d[3]);
  }
}

void RowByArithmetic(const BinaryDescriptor& a, const std::vector<BinaryDescriptor>& b, int* out) {
  const auto count = [](std::uint64_t x) {
    x -= (x >> 1) & 0x5555555555555555u;
    x = (x & 0x3333333333333333u) + ((x >> 2) & 0x3333333333333333u);
    x = (x + (x >> 4)) & 0x0f0f0f0f0f0f0f0fu;
    return static_cast<int>((x * 0x0101010101010101u) >> 56);
  };
  for (const BinaryDescriptor& d : b) {
    *out++ = count(a[0] ^ d[0]) + count(a[1] ^ d[1]) + count(a[2] ^ d[2]) + count(a[3] ^ d[3]);
  }
}

bool SamePlace(const KeyframeFeatures::Point& a, const KeyframeFeatures::Point& b) {
  return std::abs(a.u - b.u) < kSamePlace && std::abs(a.v - b.v) < kSamePlace;
}

}  // namespace

std::vector<std::pair<int, int>> MatchDescriptors(const KeyframeFeatures& a, const KeyframeFeatures& b,
                                                  int max_distance, double ratio) {
  static const bool by_instruction = HasPopcount();
  std::vector<std::pair<int, int>> out;
  if (b.Size() == 0) return out;
  std::vector<int> row(b.Size());
  // Of b: the least distance to any of a, and whose it is.
  std::vector<int> least(b.Size(), 257), nearest(b.Size(), -1), chosen(a.Size(), -1);
  for (size_t i = 0; i < a.Size(); ++i) {
    (by_instruction ? RowByInstruction : RowByArithmetic)(a.descriptors[i], b.descriptors, row.data());
    for (size_t j = 0; j < b.Size(); ++j) {
      if (row[j] < least[j]) least[j] = row[j], nearest[j] = static_cast<int>(i);
    }
    const auto best = static_cast<size_t>(std::min_element(row.begin(), row.end()) - row.begin());
    if (row[best] > max_distance) continue;
    const auto too_near = [&](size_t j) {
      return row[j] * ratio <= row[best] && j != best && !SamePlace(b.points[j], b.points[best]);
    };
    bool distinct = true;
    for (size_t j = 0; j < b.Size() && distinct; ++j) distinct = !too_near(j);
    if (distinct) chosen[i] = static_cast<int>(best);
  }
  for (size_t i = 0; i < a.Size(); ++i) {
    if (chosen[i] >= 0 && nearest[static_cast<size_t>(chosen[i])] == static_cast<int>(i)) {
      out.emplace_back(static_cast<int>(i), chosen[i]);
    }
  }
  return out;
}

}  // namespace terse
