#pragma once
// What BlockSystem::Apply did, for those who bring it into the tree of fronts or take it back.

#include "terse/core/block_system.h"

namespace terse {

namespace internal {

// Room for `more` elements, growing geometrically as push_back would.
template <class T>
void ReserveMore(std::vector<T>& v, std::size_t more) {
  if (v.size() + more > v.capacity()) v.reserve(std::max(v.size() + more, 2 * v.capacity()));
}

}  // namespace internal

template <int B>
struct BlockSystem<B>::Undo {
  int variables = 0;                                 // before
  std::vector<int> added;                            // slots
  Replaced replaced, removed;                        // slots and what was there
  std::vector<std::pair<int, Vector<B>>> diagonals;  // of old variables, before each addition to them
  std::vector<std::pair<int, int>> recounted;        // (variable, block of slots) of all other changes

  // Many changes of a hub are in the same block.
  void Recount(int variable, int block) {
    const std::pair<int, int> entry{variable, block};
    for (std::size_t k = 1; k <= 2 && k <= recounted.size(); ++k) {
      if (recounted[recounted.size() - k] == entry) return;
    }
    recounted.push_back(entry);
  }

  // Calls visit(variable) for the variables of all these linear factors, some more than once.
  template <class Visit>
  void VisitVariables(const BlockSystem& system, const Visit& visit) const {
    const auto visit_both = [&](const LinearFactor<B>& factor) {
      visit(factor.first);
      if (factor.second >= 0) visit(factor.second);
    };
    for (const int slot : added) visit_both(system.LinearFactorAt(slot));
    for (const auto& change : replaced) visit_both(change.second);
    for (const auto& change : removed) visit_both(change.second);
  }
};

}  // namespace terse
