#include "terse/covariance/covariance_blocks.h"

#include "terse/core/front_paths.h"

namespace terse {
namespace {

using internal::At;
using internal::FrontPaths;
using internal::RightHandSide;
using internal::Stride;
using std::size_t;

// So many variables are worth no bookkeeping of which columns are zero where.
constexpr size_t kFew = 2;
// Numbers that a thread's buffers may hold on to.
constexpr size_t kMostKept = size_t{1} << 20;

template <int B>
void SetIdentity(double* X, int row, int column, int stride) {
  for (int c = 0; c < B; ++c) X[At(row + c) * At(stride) + At(column + c)] = 1;
}

// The queries whose paths lead through a front, and L^-1 E of their variables there: rows of [P; S].
struct Passing {
  std::vector<int> starting;  // queries of its own pivots
  std::vector<int> below;     // path fronts under it
  std::vector<int> queries;   // all, in the order of the columns
  std::vector<double> x;
  int stride = 0;
};

// Z = L^-1 E for the pivots of the paths, in their order.
template <int B>
struct ForwardSolution {
  std::vector<int> base;   // by path front: the first row of its pivots
  std::vector<int> first;  // by path front: the first pivot row at which Z is not zero
  std::vector<int>& row_of;
  std::vector<double>& X;
  std::vector<double>& scratch;
  int stride, rows = 0;

  ForwardSolution(const BlockCholesky<B>& cholesky, const FrontPaths<B>& paths, const std::vector<RightHandSide<B>>& E)
      : base(At(paths.Size())),
        first(At(paths.Size()), internal::kNoRow),
        row_of(internal::RowScratch(cholesky.Variables())),
        X(Buffer(0)),
        scratch(Buffer(1)),
        stride(0) {
    for (const auto& e : E) stride = std::max(stride, Stride(e.column + B));
    for (int k = 0; k < paths.Size(); ++k) {
      base[At(k)] = rows;
      for (const int v : paths[k].pivots) row_of[At(v)] = std::exchange(rows, rows + B);
    }
    X.assign(At(rows) * At(stride), 0.0);
    const auto lower = [&](std::vector<int>& bound, int v) { Lower(paths, bound, v); };
    for (const auto& e : E) {
      internal::AddRightHandSide(e, row_of, X.data(), stride);
      lower(first, e.variable);
    }
    internal::ForwardPaths(paths, first, lower, row_of, X.data(), stride, scratch);
  }
  ~ForwardSolution() {
    if (X.capacity() > kMostKept) std::vector<double>().swap(X);
    if (scratch.capacity() > kMostKept) std::vector<double>().swap(scratch);
  }
  ForwardSolution(const ForwardSolution&) = delete;
  ForwardSolution& operator=(const ForwardSolution&) = delete;
  // The row of v is needed, or not zero.
  void Lower(const FrontPaths<B>& paths, std::vector<int>& bound, int v) const {
    const size_t front = At(paths.PositionOf(v));
    bound[front] = std::min(bound[front], row_of[At(v)] - base[front]);
  }

 private:
  // Stay allocated in each thread: for short paths fresh memory would cost more than the work.
  static std::vector<double>& Buffer(int which) {
    thread_local std::vector<double> buffers[2];
    return buffers[which];
  }
};

// Columns of the identity.
template <int B>
std::vector<RightHandSide<B>> Columns(const std::vector<int>& variables) {
  std::vector<RightHandSide<B>> E;
  for (const int v : variables) E.push_back({v, B * static_cast<int>(E.size()), Matrix<B, B>::Identity()});
  return E;
}

// Z' Z with all columns on all paths.
template <int B>
MatrixX Gram(const BlockCholesky<B>& cholesky, const std::vector<RightHandSide<B>>& E, Eigen::Index size) {
  FrontPaths<B> paths(cholesky.Tree());
  for (const auto& e : E) paths.Add(e.variable);
  const ForwardSolution<B> Z(cholesky, paths, E);
  const int n = Z.stride;
  MatrixX negative = MatrixX::Zero(n, n);
  internal::Kernels().subtract_product(negative.data(), n, Z.X.data(), Z.X.data(), n, n, n, Z.rows);
  MatrixX gram(size, size);
  for (Eigen::Index c = 0; c < size; ++c) {
    for (Eigen::Index r = c; r < size; ++r) gram(r, c) = gram(c, r) = -negative(r, c);
  }
  return gram;
}

// Brings together what starts at path front k and what comes from below. Returns the first row that is not zero.
template <int B>
int Meet(const BlockCholesky<B>& cholesky, const FrontPaths<B>& paths, int k, const std::vector<int>& variables,
         std::vector<Passing>& passing) {
  const auto& front = paths[k];
  Passing& here = passing[At(k)];
  std::vector<int>& row_of = internal::RowScratch(cholesky.Variables());
  int row = 0, first = front.Columns(), column = 0;
  for (const int v : front.pivots) row_of[At(v)] = std::exchange(row, row + B);
  for (const int v : front.separators) row_of[At(v)] = std::exchange(row, row + B);
  for (const int child : here.below) {
    const auto& queries = passing[At(child)].queries;
    here.queries.insert(here.queries.end(), queries.begin(), queries.end());
  }
  here.queries.insert(here.queries.end(), here.starting.begin(), here.starting.end());
  here.stride = Stride(B * static_cast<int>(here.queries.size()));
  here.x.assign(At(row) * At(here.stride), 0.0);
  for (const int child : here.below) {
    Passing& from = passing[At(child)];
    const int width = B * static_cast<int>(from.queries.size());
    const double* source = from.x.data() + At(paths[child].Columns()) * At(from.stride);
    for (const int v : paths[child].separators) {
      const int at = row_of[At(v)];
      first = std::min(first, at);
      for (int i = 0; i < B; ++i, source += from.stride) {
        std::copy_n(source, width, here.x.data() + At(at + i) * At(here.stride) + At(column));
      }
    }
    column += width;
    std::vector<double>().swap(from.x);
  }
  for (const int q : here.starting) {
    const int at = row_of[At(variables[At(q)])];
    SetIdentity<B>(here.x.data(), at, std::exchange(column, column + B), here.stride);
    first = std::min(first, at);
  }
  return first;
}

// Sigma = Z' Z: every front adds the products of its pivots' rows, to the lower triangle.
template <int B>
void AddGram(const Passing& here, int first, int rows, std::vector<double>& gram, MatrixX& joint) {
  const int n = here.stride;
  gram.assign(At(n) * At(n), 0.0);
  const double* Z = here.x.data() + At(first) * At(n);
  internal::Kernels().subtract_product(gram.data(), n, Z, Z, n, n, n, rows);
  for (size_t c = 0; c < here.queries.size(); ++c) {
    for (size_t r = c; r < here.queries.size(); ++r) {
      const Eigen::Map<const Matrix<B, B>, 0, Eigen::OuterStride<>> block(gram.data() + c * B * At(n) + r * B,
                                                                          Eigen::OuterStride<>(n));
      const int i = here.queries[r], j = here.queries[c];
      if (i >= j) {
        joint.block<B, B>(i * B, j * B) -= block;
      } else {
        joint.block<B, B>(j * B, i * B) -= block.transpose();
      }
    }
  }
}

}  // namespace

template <int B>
MatrixX CovarianceBlocks(const BlockCholesky<B>& cholesky, const std::vector<int>& rows,
                         const std::vector<int>& columns) {
  FrontPaths<B> paths(cholesky.Tree());
  for (const int v : columns) paths.Add(v);
  for (const int v : rows) paths.Add(v);
  ForwardSolution<B> solution(cholesky, paths, Columns<B>(columns));
  // Backward from the first row that is needed: an asked variable's, or that of a separator below.
  std::vector<int> needed(At(paths.Size()), internal::kNoRow);
  for (const int v : rows) solution.Lower(paths, needed, v);
  for (int k = paths.Size() - 1; k >= 0; --k) {
    if (needed[At(k)] == internal::kNoRow) continue;
    for (const int v : paths[k].separators) solution.Lower(paths, needed, v);
  }
  for (int k = 0; k < paths.Size(); ++k) {
    if (needed[At(k)] == internal::kNoRow) continue;
    internal::BackwardFront<B>(paths[k], needed[At(k)], solution.first[At(k)] == internal::kNoRow, solution.row_of,
                               solution.X.data(), solution.stride, solution.scratch);
  }
  MatrixX out(B * static_cast<Eigen::Index>(rows.size()), B * static_cast<Eigen::Index>(columns.size()));
  for (size_t r = 0; r < rows.size(); ++r) {
    for (int i = 0; i < B; ++i) {
      const double* from = solution.X.data() + At(solution.row_of[At(rows[r])] + i) * At(solution.stride);
      out.row(static_cast<Eigen::Index>(r) * B + i) = Eigen::Map<const Eigen::RowVectorXd>(from, out.cols());
    }
  }
  return out;
}

template <int B>
MatrixX JointCovariance(const BlockCholesky<B>& cholesky, const std::vector<int>& variables) {
  const Eigen::Index size = B * static_cast<Eigen::Index>(variables.size());
  if (variables.size() <= kFew) return Gram(cholesky, Columns<B>(variables), size);
  FrontPaths<B> paths(cholesky.Tree());
  for (const int v : variables) paths.Add(v);
  std::vector<Passing> passing(At(paths.Size()));
  for (size_t q = 0; q < variables.size(); ++q) {
    passing[At(paths.PositionOf(variables[q]))].starting.push_back(static_cast<int>(q));
  }
  MatrixX joint = MatrixX::Zero(size, size);
  std::vector<double> gram;
  for (int k = paths.Size() - 1; k >= 0; --k) {
    const auto& front = paths[k];
    Passing& here = passing[At(k)];
    const int ld = front.Rows(), p = front.Columns();
    const int first = Meet(cholesky, paths, k, variables, passing);
    internal::Kernels().substitute_forward(front.Entry(first, first), ld, ld - 1 - first, p - first,
                                           here.x.data() + At(first) * At(here.stride), here.stride);
    AddGram<B>(here, first, p - first, gram, joint);
    if (paths.ParentOf(k) >= 0) passing[At(paths.ParentOf(k))].below.push_back(k);
  }
  for (Eigen::Index c = 1; c < size; ++c) joint.col(c).head(c) = joint.row(c).head(c).transpose();
  return joint;
}

template <int B>
Matrix<B, B> CombinationCovariance(const BlockCholesky<B>& cholesky, const std::vector<CovarianceTerm<B>>& terms) {
  std::vector<RightHandSide<B>> E;
  for (const auto& term : terms) E.push_back({term.variable, 0, term.A.transpose()});
  return Gram(cholesky, E, B);
}

#define TERSE_INSTANTIATE(B)                                                                                       \
  template MatrixX CovarianceBlocks<B>(const BlockCholesky<B>&, const std::vector<int>&, const std::vector<int>&); \
  template MatrixX JointCovariance<B>(const BlockCholesky<B>&, const std::vector<int>&);                           \
  template Matrix<B, B> CombinationCovariance<B>(const BlockCholesky<B>&, const std::vector<CovarianceTerm<B>>&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
