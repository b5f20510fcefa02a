#pragma once
// Sets of the numbers 0, 1, ... that grow together.

#include <cstddef>
#include <numeric>
#include <vector>

namespace terse::internal {

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), std::size_t{0}); }
  // False if a and b are in one set already.
  bool Join(std::size_t a, std::size_t b) {
    a = Root(a);
    b = Root(b);
    parent_[a] = b;
    return a != b;
  }

  // The same for all of a set.
  std::size_t Root(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }

 private:
  std::vector<std::size_t> parent_;
};

}  // namespace terse::internal
