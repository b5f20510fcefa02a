#pragma once
// Symbolic elimination: from cliques of variables to a tree of fronts.
//
// Cliques are what couples variables: a factor's poses, or the separator of a subtree that is kept. The order is
// constrained minimum degree (CCOLAMD), marked variables last. A front eliminates its pivots at once; its separators
// are the later variables that this couples. Small fronts are merged into their parent where that adds few zeros.

#include <vector>

namespace terse::internal {

// Lists of variables 0..n-1, flat.
struct Cliques {
  std::vector<int> start{0};
  std::vector<int> members;
  int Count() const { return static_cast<int>(start.size()) - 1; }
  void Close() { start.push_back(static_cast<int>(members.size())); }
};

struct SymbolicFront {
  std::vector<int> pivots;      // in elimination order
  std::vector<int> separators;  // in elimination order
  int parent = -1;
  std::vector<int> cliques;  // those whose earliest variable is a pivot here
};

// Fronts with children before parents; every clique is a subset of its front's pivots and separators.
std::vector<SymbolicFront> Eliminate(int variables, const Cliques& cliques, const std::vector<char>& order_last);

}  // namespace terse::internal
