#include "factor_paths.h"

namespace terse::internal {

std::vector<int>& RowScratch(int variables) {
  thread_local std::vector<int> row_of;
  if (row_of.size() < At(variables)) row_of.resize(At(variables));
  return row_of;
}

template <int B>
void SolvePaths(const FactorPaths<B>& paths, const std::vector<RightHandSide<B>>& E, int variables,
                std::vector<double>& X, int stride) {
  const std::size_t size = At(variables) * B * At(stride);
  if (X.size() < size) X.resize(size + size / 2);
  std::vector<int>& row_of = RowScratch(variables);
  for (int v = 0; v < variables; ++v) row_of[At(v)] = B * v;
  std::vector<double> scratch;
  for (int k = 0; k < paths.Size(); ++k) {
    for (const int v : paths[k].pivots) std::fill_n(X.begin() + long{v} * B * stride, B * stride, 0.0);
  }
  std::vector<int> first(At(paths.Size()), kNoRow);
  const auto lower = [&](std::vector<int>& bound, int v) {
    int& at = bound[At(paths.PositionOf(v))];
    at = std::min(at, PivotRow<B>(paths[paths.PositionOf(v)], v));
  };
  for (const auto& e : E) {
    AddRightHandSide(e, row_of, X.data(), stride);
    lower(first, e.variable);
  }
  ForwardPaths(paths, first, lower, row_of, X.data(), stride, scratch);
  for (int k = 0; k < paths.Size(); ++k) {
    BackwardFront<B>(paths[k], 0, first[At(k)] == kNoRow, row_of, X.data(), stride, scratch);
  }
}

template <int B>
void SolveAll(const BlockCholesky<B>& factor, const std::vector<RightHandSide<B>>& E, std::vector<double>& X,
              int stride) {
  FactorPaths<B> paths(factor);
  for (const auto& e : E) paths.Add(e.variable);
  SolvePaths(paths, E, factor.Variables(), X, stride);
  const std::vector<int>& row_of = RowScratch(factor.Variables());
  std::vector<double> scratch;
  ForEachFront(factor, [&](int id, const auto& front) {
    if (paths.Find(id) < 0) BackwardFront<B>(front, 0, true, row_of, X.data(), stride, scratch);
  });
}

#define TERSE_INSTANTIATE(B)                                                                                          \
  template void SolvePaths<B>(const FactorPaths<B>&, const std::vector<RightHandSide<B>>&, int, std::vector<double>&, \
                              int);                                                                                   \
  template void SolveAll<B>(const BlockCholesky<B>&, const std::vector<RightHandSide<B>>&, std::vector<double>&, int);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
