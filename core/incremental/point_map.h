#pragma once
// New linearisation points of some poses, in the order in which they came. Finding one takes constant time, and all of
// them no more than their number.

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "terse/core/at.h"

namespace terse::internal {

template <class Pose>
class PointMap {
 public:
  bool empty() const { return points_.empty(); }
  std::size_t size() const { return points_.size(); }
  auto begin() { return points_.begin(); }
  auto end() { return points_.end(); }
  auto begin() const { return points_.begin(); }
  auto end() const { return points_.end(); }

  bool Has(int variable) const { return !points_.empty() && places_[Cell(variable)] >= 0; }
  // The pose's new point, or else the one given.
  const Pose& Find(int variable, const Pose& otherwise) const {
    const int place = points_.empty() ? -1 : places_[Cell(variable)];
    return place < 0 ? otherwise : points_[At(place)].second;
  }
  // Of a pose that has none yet.
  void Add(int variable, const Pose& point) {
    if (2 * (points_.size() + 1) > places_.size()) Grow();
    points_.emplace_back(variable, point);
    places_[Cell(variable)] = static_cast<int>(points_.size()) - 1;
  }

 private:
  // Where the variable is, or would be: the first of its cells that is its own or empty.
  std::size_t Cell(int variable) const {
    // Fibonacci hashing (Knuth, TAOCP 6.4), so that variables at equal distances do not meet.
    const std::uint64_t hash = static_cast<std::uint32_t>(variable) * std::uint64_t{0x9E3779B97F4A7C15} >> 32;
    std::size_t cell = hash & (places_.size() - 1);
    while (places_[cell] >= 0 && points_[At(places_[cell])].first != variable) cell = (cell + 1) & (places_.size() - 1);
    return cell;
  }
  void Grow() {
    places_.assign(places_.empty() ? 16 : 2 * places_.size(), -1);
    for (std::size_t k = 0; k < points_.size(); ++k) places_[Cell(points_[k].first)] = static_cast<int>(k);
  }

  std::vector<std::pair<int, Pose>> points_;
  std::vector<int> places_;  // a power of two, at least twice the points; -1: empty
};

}  // namespace terse::internal
