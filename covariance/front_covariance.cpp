#include "front_covariance.h"

#include <Eigen/Core>

namespace terse::internal {
namespace {

constexpr int kSmall = 8;    // triangles that are inverted entry by entry
constexpr int kChunk = 48;   // rows at a time where a triangle's zeros are left out
constexpr int kCorner = 24;  // diagonal blocks are computed in squares of this many rows

// Room for what will be overwritten.
void Reserve(std::vector<double>& v, std::size_t size) {
  if (v.size() < size) v.resize(size);
}

// L^-T of the p x p lower triangle at `L` into V (p x p, leading dimension ldv, column-major, upper; zero below), by
// blocks of columns.
void InverseTransposed(const double* L, int ld, int p, double* V, int ldv, std::vector<double>& scratch) {
  double W[kSmall * kSmall] = {};
  for (int i0 = 0; i0 < p; i0 += kSmall) {
    const int w = std::min(kSmall, p - i0);
    const auto l = [&](int r, int c) { return L[At(i0 + c) * At(ld) + At(i0 + r)]; };
    // W = L_ii^-1, w x w, lower.
    for (int c = 0; c < w; ++c) {
      for (int r = 0; r < c; ++r) W[c * w + r] = 0;
      W[c * w + c] = 1 / l(c, c);
    }
    for (int c = 0; c < w; ++c) {
      for (int r = c + 1; r < w; ++r) {
        double sum = 0;
        for (int k = c; k < r; ++k) sum -= l(r, k) * W[c * w + k];
        W[c * w + r] = sum * W[r * w + r];
      }
    }
    for (int c = 0; c < w; ++c) {
      double* column = V + At(i0 + c) * At(ldv);
      for (int r = 0; r < w; ++r) column[i0 + r] = W[r * w + c];
      std::fill(column + i0 + w, column + ldv, 0.0);
    }
    if (i0 == 0) continue;
    // Above: -V L_i' W'.
    for (double& x : W) x = -x;
    Reserve(scratch, At(p) * kSmall);
    for (int r0 = 0; r0 < i0; r0 += kChunk) {
      const int rows = std::min(kChunk, i0 - r0);
      Kernels().set_rectangle(scratch.data() + r0, i0, V + At(r0) * At(ldv) + At(r0), ldv, L + At(r0) * At(ld) + At(i0),
                              ld, rows, w, i0 - r0);
    }
    Kernels().set_rectangle(V + At(i0) * At(ldv), ldv, scratch.data(), i0, W, w, i0, w, w);
  }
}

// Separators that follow each other in the parent too, in scalars.
struct Run {
  int begin, rows, in_parent;
};

template <int B>
void FindRuns(const std::vector<int>& rows_in_parent, std::vector<Run>& runs) {
  runs.clear();
  for (std::size_t i = 0; i < rows_in_parent.size(); ++i) {
    if (i > 0 && rows_in_parent[i] == rows_in_parent[i - 1] + B) {
      runs.back().rows += B;
    } else {
      runs.push_back({B * static_cast<int>(i), B, rows_in_parent[i]});
    }
  }
}

template <int B>
void CopySeparators(const double* parent, int ldp, const std::vector<Run>& runs, double* Sigma_SS, int ld) {
  for (const Run& j : runs) {
    for (int c = 0; c < j.rows; ++c) {
      const double* from = parent + At(j.in_parent + c) * At(ldp);
      double* to = Sigma_SS + At(j.begin + c) * At(ld);
      for (const Run& i : runs) {
        if (i.rows > 4 * B) {
          std::copy_n(from + i.in_parent, i.rows, to + i.begin);
          continue;
        }
        for (int r = 0; r < i.rows; r += B) {
          for (int k = 0; k < B; ++k) to[i.begin + r + k] = from[i.in_parent + r + k];
        }
      }
    }
  }
}

// Sigma_PP = V V' + M K; rows r0.. of V begin at column r0. Squares on the diagonal are all that is needed if
// diagonal_only.
template <int B>
void SetPivotBlock(int p, int s, bool diagonal_only, double* Sigma, int n, FrontScratch& scratch) {
  const DenseKernels& kernels = Kernels();
  const int ldv = Padded(p), chunk = diagonal_only ? kCorner : kChunk;
  const double *V = scratch.V.data(), *K = scratch.K.data(), *M = scratch.M.data();
  Reserve(scratch.corner, At(chunk) * At(p));
  double* C = scratch.corner.data();
  for (int r0 = 0; r0 < p; r0 += chunk) {
    const int rows = std::min(chunk, ldv - r0), used = std::min(chunk, p - r0);
    const int c0 = diagonal_only ? r0 : 0, columns = r0 + used - c0;
    kernels.set_rectangle(C, rows, V + At(r0) * At(ldv) + At(r0), ldv, V + At(r0) * At(ldv) + At(c0), ldv, rows,
                          columns, p - r0);
    if (s > 0) kernels.add_rectangle(C, rows, M + r0, ldv, K + c0, ldv, rows, columns, s);
    for (int c = 0; c < columns; ++c) {
      for (int r = std::max(0, c0 + c - r0); r < used; ++r) {
        const double value = C[At(c) * At(rows) + At(r)];
        Sigma[At(c0 + c) * At(n) + At(r0 + r)] = Sigma[At(r0 + r) * At(n) + At(c0 + c)] = value;
      }
    }
  }
}

// Sigma_PS = -M, and its transpose in squares that stay in the first-level cache.
void SetCrossBlocks(int p, int s, const double* M, int ldv, double* Sigma, int n) {
  for (int j = 0; j < s; ++j) {
    const double* column = M + At(j) * At(ldv);
    double* above = Sigma + At(p + j) * At(n);
    for (int i = 0; i < p; ++i) above[i] = -column[i];
  }
  constexpr int kSquare = 16;
  for (int j0 = 0; j0 < s; j0 += kSquare) {
    const int end = std::min(s, j0 + kSquare);
    for (int i = 0; i < p; ++i) {
      double* column = Sigma + At(i) * At(n) + At(p);
      for (int j = j0; j < end; ++j) column[j] = -M[At(j) * At(ldv) + At(i)];
    }
  }
}

}  // namespace

template <int B>
void ComputeFrontCovariance(const Front<B>& front, const double* parent, int ldp,
                            const std::vector<int>& rows_in_parent, bool diagonal_only, double* Sigma,
                            FrontScratch& scratch) {
  const DenseKernels& kernels = Kernels();
  const int ld = front.Rows(), p = front.Columns(), s = ld - 1 - p, n = p + s, ldv = Padded(p);
  const auto at = [n](int row, int column) { return At(column) * At(n) + At(row); };
  Reserve(scratch.V, At(ldv) * At(p));
  Reserve(scratch.K, At(ldv) * At(s));
  Reserve(scratch.M, At(ldv) * At(s));
  double *V = scratch.V.data(), *K = scratch.K.data(), *M = scratch.M.data();
  InverseTransposed(front.panel.Numbers(), ld, p, V, ldv, scratch.corner);
  if (s > 0) {
    // K' = L_PP^-T L_SP' (p x s).
    for (int r0 = 0; r0 < ldv; r0 += kChunk) {
      const int rows = std::min(kChunk, ldv - r0);
      kernels.set_rectangle(K + r0, ldv, V + At(r0) * At(ldv) + At(r0), ldv, front.Entry(p, r0), ld, rows, s, p - r0);
    }
    // M = K' Sigma_SS = -Sigma_PS.
    thread_local std::vector<Run> runs;
    FindRuns<B>(rows_in_parent, runs);
    if (diagonal_only && runs.size() <= 4) {
      for (const Run& j : runs) {
        for (const Run& i : runs) {
          const auto product = i.begin == 0 ? kernels.set_rectangle : kernels.add_rectangle;
          product(M + At(j.begin) * At(ldv), ldv, K + At(i.begin) * At(ldv), ldv,
                  parent + At(i.in_parent) * At(ldp) + At(j.in_parent), ldp, ldv, j.rows, i.rows);
        }
      }
    } else {
      CopySeparators<B>(parent, ldp, runs, Sigma + at(p, p), n);
      kernels.set_rectangle(M, ldv, K, ldv, Sigma + at(p, p), n, ldv, s, s);
    }
  }
  SetPivotBlock<B>(p, s, diagonal_only, Sigma, n, scratch);
  if (!diagonal_only) SetCrossBlocks(p, s, M, ldv, Sigma, n);
}

// X_P = -K' X_S, for a front off the path of the column's variable.
template <int B>
void ExtendColumn(const Front<B>& front, const FrontScratch& scratch, std::vector<double>& X,
                  std::vector<double>& buffer) {
  constexpr int kStride = Stride(B);
  const int p = front.Columns(), s = front.Rows() - 1 - p, ldv = Padded(p);
  Reserve(buffer, At(s) * kStride + At(ldv) * B);
  double *X_S = buffer.data(), *out = buffer.data() + At(s) * kStride;
  for (std::size_t k = 0; k < front.separators.size(); ++k) {
    const double* from = X.data() + At(front.separators[k]) * B * kStride;
    for (int i = 0; i < B * kStride; ++i) X_S[k * B * kStride + At(i)] = from[i];
  }
  if (s > 0) {
    Kernels().set_rectangle(out, ldv, scratch.K.data(), ldv, X_S, kStride, ldv, B, s);
  } else {
    std::fill_n(out, At(ldv) * B, 0.0);  // the root of another component
  }
  for (std::size_t k = 0; k < front.pivots.size(); ++k) {
    double* to = X.data() + At(front.pivots[k]) * B * kStride;
    for (int r = 0; r < B; ++r) {
      for (int c = 0; c < B; ++c) to[r * kStride + c] = -out[At(c) * At(ldv) + k * B + At(r)];
      for (int c = B; c < kStride; ++c) to[r * kStride + c] = 0;
    }
  }
}

template <int B>
void ComputeAllDiagonals(const BlockCholesky<B>& cholesky, std::vector<Matrix<B, B>>& out, RecursionScratch& scratch,
                         const ColumnOfAll* column) {
  out.resize(At(cholesky.Variables()));
  const FrontTree<B>& tree = cholesky.Tree();
  FrontPaths<B> paths(tree);
  if (column != nullptr) {
    paths.Add(column->variable);
    SolvePaths(paths, {{column->variable, 0, Matrix<B, B>::Identity()}}, cholesky.Variables(), *column->X, Stride(B));
  }
  std::vector<RecursionLevel>& path = scratch.path;
  std::size_t depth = 0;  // levels in use; those below keep their buffers
  const auto visit = [&](int id, const std::vector<int>& rows) {
    if (path.size() == depth) path.emplace_back();
    RecursionLevel& here = path[depth];
    const auto& front = tree[id];
    const int n = here.n = front.Rows() - 1;
    here.front = id;
    here.next_child = 0;
    if (here.covariance.size() < At(n) * At(n)) here.covariance.resize(At(n) * At(n));
    const RecursionLevel* parent = depth > 0 ? &path[depth - 1] : nullptr;
    ComputeFrontCovariance<B>(front, parent ? parent->covariance.data() : nullptr, parent ? parent->n : 0, rows,
                              front.children.empty(), here.covariance.data(), scratch.front);
    if (column != nullptr && paths.Find(id) < 0) ExtendColumn<B>(front, scratch.front, *column->X, scratch.column);
    const Eigen::Map<const MatrixX> Sigma(here.covariance.data(), n, n);
    Eigen::Index at = 0;
    for (const int v : front.pivots) {
      out[At(v)] = Sigma.block<B, B>(at, at);
      at += B;
    }
    ++depth;
    if (front.children.empty()) return;
    SetRows<B>(front, cholesky.Variables(), scratch.front);
    here.rows.resize(front.children.size());
    for (std::size_t k = 0; k < front.children.size(); ++k) {
      SeparatorRows<B>(tree[front.children[k]], scratch.front, here.rows[k]);
    }
  };
  for (const int root : tree.Roots()) {
    visit(root, {});
    while (depth > 0) {
      RecursionLevel& top = path[depth - 1];
      const auto& children = tree[top.front].children;
      if (top.next_child == children.size()) {
        --depth;
      } else {
        const std::size_t k = top.next_child++;
        const std::vector<int> rows = std::move(top.rows[k]);
        visit(children[k], rows);
      }
    }
  }
}

template void ComputeAllDiagonals<3>(const BlockCholesky<3>&, std::vector<Matrix<3, 3>>&, RecursionScratch&,
                                     const ColumnOfAll*);
template void ComputeAllDiagonals<6>(const BlockCholesky<6>&, std::vector<Matrix<6, 6>>&, RecursionScratch&,
                                     const ColumnOfAll*);
template void ComputeFrontCovariance<3>(const Front<3>&, const double*, int, const std::vector<int>&, bool, double*,
                                        FrontScratch&);
template void ComputeFrontCovariance<6>(const Front<6>&, const double*, int, const std::vector<int>&, bool, double*,
                                        FrontScratch&);

}  // namespace terse::internal
