#pragma once
// What the parts of BlockCholesky::Update share.

#include <algorithm>

#include "cholesky/elimination.h"
#include "terse/core/block_cholesky.h"

namespace terse {

namespace internal {

// Room for `more` elements, growing geometrically as push_back would.
template <class T>
void ReserveMore(std::vector<T>& v, std::size_t more) {
  if (v.size() + more > v.capacity()) v.reserve(std::max(v.size() + more, 2 * v.capacity()));
}

}  // namespace internal

// What ApplyFactors did, so that a failed update can be taken back.
template <int B>
struct BlockCholesky<B>::Undo {
  int variables = 0;
  std::vector<int> added;
  std::vector<std::pair<int, LinearFactor<B>>> replaced, removed;
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

  // Calls visit(variable) for the variables of all these factors, some more than once; the added ones are in `slots`.
  template <class Visit>
  void VisitVariables(const std::vector<LinearFactor<B>>& slots, const Visit& visit) const {
    const auto visit_both = [&](const LinearFactor<B>& factor) {
      visit(factor.first);
      if (factor.second >= 0) visit(factor.second);
    };
    for (const int slot : added) visit_both(slots[static_cast<std::size_t>(slot)]);
    for (const auto& change : replaced) visit_both(change.second);
    for (const auto& change : removed) visit_both(change.second);
  }
};

// The touched part of the tree: what is eliminated again, and what that hangs together by.
template <int B>
struct BlockCholesky<B>::Region {
  std::vector<int> fronts;                  // the touched variables' and all their ancestors
  std::vector<int> variables;               // their pivots and the new variables
  const std::vector<int>* added = nullptr;  // slots that no front has yet
  internal::Cliques cliques;                // in indices of `variables`
  // A clique's origin: a factor, or the separator of a subtree that stays; the other is -1.
  std::vector<int> slot, orphan;
  std::vector<char> order_last;
};

// A rank-k update: the fronts it goes through, and where its factors join it.
template <int B>
struct BlockCholesky<B>::RankPath {
  std::vector<int> fronts;                  // children before parents
  std::vector<std::pair<int, int>> starts;  // (position in `fronts`, slot), ascending
};

}  // namespace terse
