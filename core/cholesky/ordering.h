#pragma once
// Orders of elimination: constrained minimum degree (CCOLAMD), and nested dissection (SCOTCH) for large graphs.

#include <vector>

namespace terse::internal {

// Lists of variables 0..n-1, flat.
struct Cliques {
  std::vector<int> start{0};
  std::vector<int> members;
  int Count() const { return static_cast<int>(start.size()) - 1; }
  void Close() { start.push_back(static_cast<int>(members.size())); }
};

// First to last, as variables; those marked in order_last come last.
std::vector<int> MinimumDegreeOrder(int variables, const Cliques& cliques, const std::vector<char>& order_last);

// The same, by separators that part the graph again and again, which makes the paths to the root short. Empty where
// that is not for this graph: it has hubs, or cliques too large to be written as pairs. The same for the same cliques.
std::vector<int> NestedDissectionOrder(int variables, const Cliques& cliques, const std::vector<char>& order_last);

}  // namespace terse::internal
