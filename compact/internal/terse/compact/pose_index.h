#pragma once
// Which kept poses can be within reach of a new one, without looking at all of them.
//
// A tree of bounding boxes over the kept poses in order of arrival, in which neighbours are close and about equally
// well known. A box also carries the largest spread in it: how far off, root mean square, the displacement to the
// kept pose `base` can be. By Minkowski's inequality a chain of length l from base on, with spreads m_c and r_c of its
// own, makes of it
//   m <- hypot(m + r l, m_c),   r <- hypot(r, r_c):
// an error of rotation acts over the length, independent errors add in squares.

#include <algorithm>
#include <cmath>
#include <vector>

#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse {

// Root mean square error of a displacement in translation and in rotation.
struct Spread {
  double metres = 0, radians = 0;

  template <class Pose>
  static Spread Of(const typename Pose::Jacobian& covariance) {
    const auto d = covariance.diagonal();
    return {std::sqrt(std::max(0.0, d.template head<Pose::kDim>().sum())),
            std::sqrt(std::max(0.0, d.template tail<Pose::kDof - Pose::kDim>().sum()))};
  }
  // Of the displacement composed with a chain of this length and spread.
  Spread Behind(double length, const Spread& chain) const {
    return {std::hypot(metres + radians * length, chain.metres), std::hypot(radians, chain.radians)};
  }
};

template <class Pose>
class PoseIndex {
 public:
  using Position = typename Pose::Position;

  struct Item {
    Position position;
    Spread spread;
  };

  // O(items).
  void Build(std::vector<Item> items) {
    items_ = std::move(items);
    buckets_ = 1;
    while (buckets_ * kBucket < items_.size()) buckets_ *= 2;
    boxes_.assign(2 * buckets_, Box());
    for (std::size_t i = 0; i < items_.size(); ++i) boxes_[buckets_ + i / kBucket].Include(items_[i]);
    for (std::size_t k = buckets_ - 1; k > 0; --k) boxes_[k] = Box::Around(boxes_[2 * k], boxes_[2 * k + 1]);
  }

  const std::vector<Item>& Items() const { return items_; }

  // Calls visit(i), i ascending, for every item no farther from `position` than reach(spread), which must grow with
  // both numbers, and for few others.
  template <class Reach, class Visit>
  void VisitNear(const Position& position, const Reach& reach, const Visit& visit) const {
    if (!items_.empty()) VisitBox(1, position, reach, visit);
  }

 private:
  static constexpr std::size_t kBucket = 8;
  struct Box {
    Position low = Position::Constant(1e300), high = Position::Constant(-1e300);
    Spread spread;
    void Include(const Item& item) {
      low = low.cwiseMin(item.position);
      high = high.cwiseMax(item.position);
      spread = {std::max(spread.metres, item.spread.metres), std::max(spread.radians, item.spread.radians)};
    }
    static Box Around(const Box& a, const Box& b) {
      Box out;
      out.low = a.low.cwiseMin(b.low);
      out.high = a.high.cwiseMax(b.high);
      out.spread = {std::max(a.spread.metres, b.spread.metres), std::max(a.spread.radians, b.spread.radians)};
      return out;
    }
    bool IsEmpty() const { return low[0] > high[0]; }
    double Distance(const Position& p) const { return (p - p.cwiseMax(low).cwiseMin(high)).norm(); }
  };

  template <class Reach, class Visit>
  void VisitBox(std::size_t k, const Position& position, const Reach& reach, const Visit& visit) const {
    if (boxes_[k].IsEmpty() || boxes_[k].Distance(position) > reach(boxes_[k].spread)) return;
    if (k < buckets_) {
      VisitBox(2 * k, position, reach, visit);
      VisitBox(2 * k + 1, position, reach, visit);
      return;
    }
    const std::size_t first = (k - buckets_) * kBucket;
    for (std::size_t i = first; i < std::min(first + kBucket, items_.size()); ++i) visit(static_cast<int>(i));
  }

  std::vector<Item> items_;
  std::vector<Box> boxes_;  // the root is 1, the children of k are 2 k and 2 k + 1, the last half are buckets
  std::size_t buckets_ = 0;
};

}  // namespace terse
