#pragma once
// What the ways to bring changes into the tree of fronts work on.

#include "cholesky/front_factorization.h"
#include "cholesky/undo.h"

namespace terse::internal {

template <int B>
struct UpdateContext {
  const BlockSystem<B>& system;               // with the changes in it
  const typename BlockSystem<B>::Undo& undo;  // what they were
  FrontTree<B>& tree;
  FrontFactorization<B>& numbers;
  std::uint64_t version;  // that the tree will have
  CholeskyReport& report;
};

}  // namespace terse::internal
