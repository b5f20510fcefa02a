#pragma once
// Symbolic elimination: from cliques of variables to a tree of fronts.
//
// Cliques are what couples variables: a factor's poses, or the separator of a subtree that is kept. A front eliminates
// its pivots at once; its separators are the later variables that this couples. Small fronts are merged into their
// parent where that adds few zeros.

#include <cstddef>
#include <vector>

#include "cholesky/ordering.h"

namespace terse::internal {

struct SymbolicFront {
  std::vector<int> pivots;      // in elimination order
  std::vector<int> separators;  // in elimination order
  int parent = -1;
  std::vector<int> cliques;  // those whose earliest variable is a pivot here
};

// What a tree of fronts costs, in blocks.
struct FactorCost {
  double flops = 0;  // of factoring everything
  double paths = 0;  // entries of L on the way from a variable to its root, summed over the variables
  // Adds a front below one whose way to the root has `above` entries; returns what its own has.
  double Add(double pivots, double separators, double above);
};
FactorCost CostOf(const std::vector<SymbolicFront>& fronts);

// Minimum degree, or nested dissection where that costs less: for factoring and solving, or for updates along paths
// too.
enum class OrderFor { kSolving, kUpdates };

// Fronts with children before parents; every clique is a subset of its front's pivots and separators.
// In an order that is given, or one that is looked for.
std::vector<SymbolicFront> EliminateInOrder(const Cliques& cliques, std::vector<int> order);
std::vector<SymbolicFront> Eliminate(int variables, const Cliques& cliques, const std::vector<char>& order_last,
                                     OrderFor purpose);

// Throws std::invalid_argument if an order is given that is not of so many variables.
void RequireOrder(const std::vector<int>& order, std::size_t variables);

}  // namespace terse::internal
