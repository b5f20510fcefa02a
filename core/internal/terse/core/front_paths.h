#pragma once
// Paths of fronts up to the root, and substitution with L along them: the only place, beside the factorisation itself,
// that reads a front's panel row by row.
//
// Right-hand sides side by side: X is row-major with `stride` columns; a variable's rows start at row_of[variable].

#include <algorithm>
#include <limits>
#include <vector>

#include "terse/core/dense_kernels.h"
#include "terse/core/front_tree.h"

namespace terse::internal {

// The fronts from some variables up to their roots, parents before children: a set that is closed under ancestors.
template <int B>
class FrontPaths {
 public:
  explicit FrontPaths(const FrontTree<B>& tree) : tree_(&tree) {}
  ~FrontPaths() {
    for (const int f : fronts_) Position(f) = -1;
  }
  FrontPaths(const FrontPaths&) = delete;
  FrontPaths& operator=(const FrontPaths&) = delete;

  void Add(int variable) {
    const std::size_t begin = fronts_.size();
    tree_->Climb(tree_->FrontOf(variable), [&](int f) {
      if (Position(f) >= 0) return false;
      fronts_.push_back(f);
      Position(f) = 0;
      return true;
    });
    std::reverse(fronts_.begin() + static_cast<long>(begin), fronts_.end());
    for (std::size_t k = begin; k < fronts_.size(); ++k) Position(fronts_[k]) = static_cast<int>(k);
  }
  int Size() const { return static_cast<int>(fronts_.size()); }
  int IdAt(int k) const { return fronts_[At(k)]; }
  const Front<B>& operator[](int k) const { return (*tree_)[fronts_[At(k)]]; }
  // Where a front, the front of a variable, or the parent of a front, is in the list; -1: it is not.
  int Find(int front) const { return Position(front); }
  int PositionOf(int variable) const { return Position(tree_->FrontOf(variable)); }
  int ParentOf(int k) const {
    const int parent = (*this)[k].parent;
    return parent < 0 ? -1 : Position(parent);
  }
  // Calls visit(front) for those that Add would bring in.
  template <class Visit>
  void ForEachMissing(int variable, const Visit& visit) const {
    tree_->Climb(tree_->FrontOf(variable), [&](int f) {
      if (Position(f) >= 0) return false;
      visit((*tree_)[f]);
      return true;
    });
  }

 private:
  // By front, -1 between uses; one list at a time in each thread.
  static int& Position(int front) {
    thread_local std::vector<int> positions;
    if (positions.size() <= At(front)) positions.resize(At(front) + 1, -1);
    return positions[At(front)];
  }
  const FrontTree<B>* tree_;
  std::vector<int> fronts_;
};

// Scalars before a variable's in its front.
template <int B>
int PivotRow(const Front<B>& front, int variable) {
  return B * static_cast<int>(std::find(front.pivots.begin(), front.pivots.end(), variable) - front.pivots.begin());
}

template <int B>
void GatherRows(const std::vector<int>& variables, const std::vector<int>& row_of, const double* X, int stride,
                double* out) {
  for (const int v : variables) {
    const double* from = X + At(row_of[At(v)]) * At(stride);
    for (int k = 0; k < B * stride; k += B * kLanes, out += B * kLanes) {
      for (int i = 0; i < B * kLanes; ++i) out[i] = from[k + i];
    }
  }
}

template <int B>
void ScatterRows(const std::vector<int>& variables, const std::vector<int>& row_of, const double* in, int stride,
                 double* X) {
  for (const int v : variables) {
    double* to = X + At(row_of[At(v)]) * At(stride);
    for (int k = 0; k < B * stride; k += B * kLanes, in += B * kLanes) {
      for (int i = 0; i < B * kLanes; ++i) to[k + i] = in[i];
    }
  }
}

// X_P = L_PP^-1 X_P, X_S -= L_SP X_P, where X is zero before row `first` of the front.
template <int B>
void ForwardFront(const Front<B>& front, int first, const std::vector<int>& row_of, double* X, int stride,
                  std::vector<double>& scratch) {
  const int ld = front.Rows(), rows = ld - 1, p = front.Columns();
  scratch.resize(At(rows) * At(stride));
  GatherRows<B>(front.pivots, row_of, X, stride, scratch.data());
  GatherRows<B>(front.separators, row_of, X, stride, scratch.data() + At(p) * At(stride));
  Kernels().substitute_forward(front.Entry(first, first), ld, rows - first, p - first,
                               scratch.data() + At(first) * At(stride), stride);
  ScatterRows<B>(front.pivots, row_of, scratch.data(), stride, X);
  ScatterRows<B>(front.separators, row_of, scratch.data() + At(p) * At(stride), stride, X);
}

// X_P = L_PP^-T (X_P - L_SP' X_S) from row `first` of the front on. If is_zero, X_P is taken for zero.
template <int B>
void BackwardFront(const Front<B>& front, int first, bool is_zero, const std::vector<int>& row_of, double* X,
                   int stride, std::vector<double>& scratch) {
  const int ld = front.Rows(), rows = ld - 1, p = front.Columns();
  scratch.resize(At(rows) * At(stride));
  if (is_zero) {
    std::fill_n(scratch.begin(), At(p) * At(stride), 0.0);
  } else {
    GatherRows<B>(front.pivots, row_of, X, stride, scratch.data());
  }
  GatherRows<B>(front.separators, row_of, X, stride, scratch.data() + At(p) * At(stride));
  Kernels().substitute_backward(front.Entry(first, first), ld, rows - first, p - first,
                                scratch.data() + At(first) * At(stride), stride);
  ScatterRows<B>(front.pivots, row_of, scratch.data(), stride, X);
}

// Forward along the paths. first[k]: the first row of front k at which X is not zero, kNoRow if it is; lower(first, v)
// says that it is not zero at v.
inline constexpr int kNoRow = std::numeric_limits<int>::max();
template <int B, class Lower>
void ForwardPaths(const FrontPaths<B>& paths, std::vector<int>& first, const Lower& lower,
                  const std::vector<int>& row_of, double* X, int stride, std::vector<double>& scratch) {
  for (int k = paths.Size() - 1; k >= 0; --k) {
    if (first[At(k)] == kNoRow) continue;
    ForwardFront<B>(paths[k], first[At(k)], row_of, X, stride, scratch);
    for (const int v : paths[k].separators) lower(first, v);
  }
}

// A block of right-hand sides.
template <int B>
struct RightHandSide {
  int variable, column;
  Matrix<B, B> block;
};

template <int B>
void AddRightHandSide(const RightHandSide<B>& e, const std::vector<int>& row_of, double* X, int stride) {
  Eigen::Map<Eigen::Matrix<double, B, B, Eigen::RowMajor>, 0, Eigen::OuterStride<>>(
      X + At(row_of[At(e.variable)]) * At(stride) + At(e.column), Eigen::OuterStride<>(stride)) += e.block;
}

// X = H^-1 E for the pivots of the paths of E's variables: E is the sum of the blocks, X has the rows of variable v
// from B v on. What was in X before does not matter, if it is finite. All must be among the paths.
template <int B>
void SolvePaths(const FrontPaths<B>& paths, const std::vector<RightHandSide<B>>& E, int variables,
                std::vector<double>& X, int stride);

// The same for all variables.
template <int B>
void SolveAll(const FrontTree<B>& tree, const std::vector<RightHandSide<B>>& E, std::vector<double>& X, int stride);

// The same for dense right-hand sides: X = H^-1 X.
template <int B>
void SolveDense(const FrontTree<B>& tree, std::vector<double>& X, int stride);

// x_P = L_PP^-T (x_P - L_SP' d_S) for a single right-hand side; x has room for as many as the panel has rows, d_S comes
// from `solution`, by variable.
template <int B>
void BackSubstituteFront(const Front<B>& front, const double* solution, double* x) {
  double* separators = x + front.Columns();
  for (const int v : front.separators) separators = std::copy_n(solution + At(v) * B, B, separators);
  Kernels().back_substitute(front.panel.Numbers(), front.Rows(), front.Columns(), x);
}

// L' d = y on these fronts alone: their share of the full Gauss-Newton step (Arablouei 2026 Eq. 15, which holds for
// sets that are closed under ancestors). Calls set(variable, d) as it goes; solution: all d, as they are set.
template <int B, class Set>
void SolveOn(const FrontPaths<B>& paths, const std::vector<double>& solution, const Set& set) {
  std::vector<double> x;
  for (int k = 0; k < paths.Size(); ++k) {
    const Front<B>& front = paths[k];
    x.resize(At(front.Rows()));
    front.CopyRightHandSide(x.data());
    BackSubstituteFront(front, solution.data(), x.data());
    const double* d = x.data();
    for (const int v : front.pivots) {
      set(v, Vector<B>(Eigen::Map<const Vector<B>>(d)));
      d += B;
    }
  }
}

// Z = L^-1 A' of a linear factor, B columns and what fills them up to the stride, on the fronts from its variables to
// the root; all else is zero.
template <int B>
struct PathColumns {
  struct Piece {
    int front, rows;
    std::size_t at;  // in values, row-major
  };
  std::vector<Piece> pieces;  // by front, ascending
  std::vector<double> values;

  bool IsEmpty() const { return pieces.empty(); }
  const double* On(const Piece& piece) const { return values.data() + piece.at; }
  const Piece* Find(int front) const {
    const auto it = std::lower_bound(pieces.begin(), pieces.end(), front,
                                     [](const Piece& piece, int f) { return piece.front < f; });
    return it != pieces.end() && it->front == front ? &*it : nullptr;
  }
};
template <int B>
PathColumns<B> SolveForward(const FrontTree<B>& tree, const LinearFactor<B>& f);
// a' b.
template <int B>
Matrix<B, B> Gram(const PathColumns<B>& a, const PathColumns<B>& b);
// Z' Z of many side by side, in blocks of B.
template <int B>
Eigen::MatrixXd JointGram(const std::vector<const PathColumns<B>*>& columns);
// x with L' x = Z q, of all variables.
template <int B>
std::vector<double> SolveBackward(const FrontTree<B>& tree, const PathColumns<B>& Z, const Vector<B>& q);

// By variable, one use at a time in each thread; what is in it is old.
std::vector<int>& RowScratch(int variables);

}  // namespace terse::internal
