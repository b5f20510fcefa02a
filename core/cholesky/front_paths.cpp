#include "terse/core/front_paths.h"

#include <cassert>
#include <tuple>
#include <utility>

namespace terse::internal {
namespace {

// Columns of a product of a matrix with itself that are made at once, those above the diagonal too.
constexpr int kTogether = 24;

}  // namespace

std::vector<int>& RowScratch(int variables) {
  thread_local std::vector<int> row_of;
  if (row_of.size() < At(variables)) row_of.resize(At(variables));
  return row_of;
}

template <int B>
void SolvePaths(const FrontPaths<B>& paths, const std::vector<RightHandSide<B>>& E, int variables,
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
void SolveAll(const FrontTree<B>& tree, const std::vector<RightHandSide<B>>& E, std::vector<double>& X, int stride) {
  FrontPaths<B> paths(tree);
  for (const auto& e : E) paths.Add(e.variable);
  SolvePaths(paths, E, tree.Variables(), X, stride);
  const std::vector<int>& row_of = RowScratch(tree.Variables());
  std::vector<double> scratch;
  tree.ForEach([&](int id, const auto& front) {
    if (paths.Find(id) < 0) BackwardFront<B>(front, 0, true, row_of, X.data(), stride, scratch);
  });
}

template <int B>
void SolveDense(const FrontTree<B>& tree, std::vector<double>& X, int stride) {
  std::vector<int>& row_of = RowScratch(tree.Variables());
  for (int v = 0; v < tree.Variables(); ++v) row_of[At(v)] = B * v;
  std::vector<double> scratch;
  std::vector<const Front<B>*> fronts;
  tree.ForEach([&](int, const Front<B>& front) { fronts.push_back(&front); });
  for (auto front = fronts.rbegin(); front != fronts.rend(); ++front) {
    ForwardFront<B>(**front, 0, row_of, X.data(), stride, scratch);
    (*front)->panel.Release();
  }
  for (const Front<B>* front : fronts) {
    BackwardFront<B>(*front, 0, false, row_of, X.data(), stride, scratch);
    front->panel.Release();
  }
}

template <int B>
PathColumns<B> SolveForward(const FrontTree<B>& tree, const LinearFactor<B>& f) {
  constexpr int kStride = Stride(B);
  FrontPaths<B> paths(tree);
  paths.Add(f.second);
  paths.Add(f.first);
  std::vector<int>& row_of = RowScratch(tree.Variables());
  int rows = 0;
  for (int k = 0; k < paths.Size(); ++k) {
    for (const int v : paths[k].pivots) row_of[At(v)] = std::exchange(rows, rows + B);
  }
  std::vector<double> X(At(rows) * kStride), scratch;
  std::vector<int> first(At(paths.Size()), kNoRow);
  const auto lower = [&](std::vector<int>& bound, int v) {
    int& at = bound[At(paths.PositionOf(v))];
    at = std::min(at, PivotRow<B>(paths[paths.PositionOf(v)], v));
  };
  const auto add = [&](int v, const Matrix<B, B>& A) {
    AddRightHandSide<B>({v, 0, A.transpose()}, row_of, X.data(), kStride);
    lower(first, v);
  };
  add(f.first, f.A_first);
  add(f.second, f.A_second);
  ForwardPaths(paths, first, lower, row_of, X.data(), kStride, scratch);
  PathColumns<B> out{{}, std::move(X)};
  out.pieces.reserve(At(paths.Size()));
  std::size_t at = 0;
  for (int k = 0; k < paths.Size(); ++k) {
    const int columns = paths[k].Columns();
    out.pieces.push_back({paths.IdAt(k), columns, at});
    at += At(columns) * kStride;
  }
  std::sort(out.pieces.begin(), out.pieces.end(), [](const auto& a, const auto& b) { return a.front < b.front; });
  return out;
}

template <int B>
Matrix<B, B> Gram(const PathColumns<B>& a, const PathColumns<B>& b) {
  Matrix<B, B> sum = Matrix<B, B>::Zero();
  const auto add = Kernels().add_rectangle;
  for (auto at_a = a.pieces.begin(), at_b = b.pieces.begin(); at_a != a.pieces.end() && at_b != b.pieces.end();) {
    if (at_a->front < at_b->front) {
      ++at_a;
    } else if (at_b->front < at_a->front) {
      ++at_b;
    } else {
      assert(at_a->rows == at_b->rows);
      add(sum.data(), B, a.On(*at_a), Stride(B), b.On(*at_b), Stride(B), B, B, at_a->rows);
      ++at_a;
      ++at_b;
    }
  }
  return sum;
}

// Front by front, of those that pass it: near the root that is all of them, and the product is a large one.
template <int B>
Eigen::MatrixXd JointGram(const std::vector<const PathColumns<B>*>& columns) {
  struct Passing {
    int front, at, rows;
    const double* z;
  };
  std::vector<Passing> all;
  int size = 0;
  for (const PathColumns<B>* path : columns) {
    for (const auto& piece : path->pieces) all.push_back({piece.front, size, piece.rows, path->On(piece)});
    size += B;
  }
  std::sort(all.begin(), all.end(),
            [](const Passing& a, const Passing& b) { return std::tie(a.front, a.at) < std::tie(b.front, b.at); });
  Eigen::MatrixXd joint = Eigen::MatrixXd::Zero(size, size);
  std::vector<double> side, product;  // all that pass side by side, and the lower triangle of their product
  const auto add = Kernels().add_rectangle;
  for (auto first = all.begin(); first != all.end();) {
    const auto last = std::find_if(first, all.end(), [&](const Passing& p) { return p.front != first->front; });
    const int width = B * static_cast<int>(last - first), rows = first->rows;
    side.resize(At(width) * At(rows));
    for (auto p = first; p != last; ++p) {
      assert(p->rows == rows);
      double* to = side.data() + B * (p - first);
      for (int i = 0; i < rows; ++i) std::copy_n(p->z + i * Stride(B), B, to + i * width);
    }
    const bool are_all = width == size;
    if (!are_all) product.assign(At(width) * At(width), 0);
    double* sum = are_all ? joint.data() : product.data();
    for (int j = 0; j < width; j += kTogether) {
      add(sum + At(j) * At(width) + At(j), width, side.data() + j, width, side.data() + j, width, width - j,
          std::min(kTogether, width - j), rows);
    }
    for (auto p = first; !are_all && p != last; ++p) {
      const Eigen::Map<const Eigen::MatrixXd> part(product.data() + B * width * (p - first), width, B);
      for (auto q = p; q != last; ++q) {
        joint.block<B, B>(q->at, p->at) += part.middleRows<B>(static_cast<Eigen::Index>(B * (q - first)));
      }
    }
    first = last;
  }
  joint.triangularView<Eigen::StrictlyUpper>() = joint.transpose();
  return joint;
}

template <int B>
std::vector<double> SolveBackward(const FrontTree<B>& tree, const PathColumns<B>& Z, const Vector<B>& q) {
  std::vector<double> x(At(tree.Variables()) * B, 0.0), of_front;
  std::vector<int> stack = tree.Roots();
  while (!stack.empty()) {
    const int id = stack.back();
    stack.pop_back();
    const auto& front = tree[id];
    const auto is_zero = [&](int v) {
      return std::all_of(&x[At(v) * B], &x[At(v) * B] + B, [](double e) { return e == 0; });
    };
    const auto* piece = Z.Find(id);
    if (piece == nullptr && std::all_of(front.separators.begin(), front.separators.end(), is_zero)) continue;
    of_front.assign(At(front.Rows()), 0.0);
    for (int i = 0; piece != nullptr && i < piece->rows; ++i) {
      of_front[At(i)] = Eigen::Map<const Vector<B>>(Z.On(*piece) + i * Stride(B)).dot(q);
    }
    BackSubstituteFront(front, x.data(), of_front.data());
    for (std::size_t k = 0; k < front.pivots.size(); ++k) {
      std::copy_n(&of_front[k * B], B, &x[At(front.pivots[k]) * B]);
    }
    stack.insert(stack.end(), front.children.begin(), front.children.end());
  }
  return x;
}

#define TERSE_INSTANTIATE(B)                                                                                         \
  template void SolvePaths<B>(const FrontPaths<B>&, const std::vector<RightHandSide<B>>&, int, std::vector<double>&, \
                              int);                                                                                  \
  template void SolveAll<B>(const FrontTree<B>&, const std::vector<RightHandSide<B>>&, std::vector<double>&, int);   \
  template void SolveDense<B>(const FrontTree<B>&, std::vector<double>&, int);                                       \
  template PathColumns<B> SolveForward<B>(const FrontTree<B>&, const LinearFactor<B>&);                              \
  template Matrix<B, B> Gram<B>(const PathColumns<B>&, const PathColumns<B>&);                                       \
  template Eigen::MatrixXd JointGram<B>(const std::vector<const PathColumns<B>*>&);                                  \
  template std::vector<double> SolveBackward<B>(const FrontTree<B>&, const PathColumns<B>&, const Vector<B>&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
