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

// L^-T of the p x p lower triangle at `L` into V (p x p, column-major, upper; zero below), by blocks of columns.
void InverseTransposed(const double* L, int ld, int p, std::vector<double>& V, std::vector<double>& scratch) {
  Reserve(V, At(p) * At(p));
  Reserve(scratch, At(p) * kSmall);
  double W[kSmall * kSmall] = {};
  for (int i0 = 0; i0 < p; i0 += kSmall) {
    const int w = std::min(kSmall, p - i0);
    const auto l = [&](int r, int c) { return L[At(i0 + c) * At(ld) + At(i0 + r)]; };
    // W = L_ii^-1, w x w, lower.
    for (int c = 0; c < w; ++c) {
      for (int r = 0; r < c; ++r) W[c * w + r] = 0;
      for (int r = c; r < w; ++r) {
        double sum = r == c ? 1 : 0;
        for (int k = c; k < r; ++k) sum -= l(r, k) * W[c * w + k];
        W[c * w + r] = sum / l(r, r);
      }
    }
    for (int c = 0; c < w; ++c) {
      double* column = V.data() + At(i0 + c) * At(p);
      for (int r = 0; r < w; ++r) column[i0 + r] = W[r * w + c];
      std::fill(column + i0 + w, column + p, 0.0);
    }
    // Above: -V L_i' W'.
    for (double& x : W) x = -x;
    for (int r0 = 0; r0 < i0; r0 += kChunk) {
      const int rows = std::min(kChunk, i0 - r0);
      Kernels().set_rectangle(scratch.data() + r0, i0, V.data() + At(r0) * At(p) + At(r0), p,
                              L + At(r0) * At(ld) + At(i0), ld, rows, w, i0 - r0);
    }
    if (i0 > 0) Kernels().set_rectangle(V.data() + At(i0) * At(p), p, scratch.data(), i0, W, w, i0, w, w);
  }
}

// Sigma_SS, in runs of variables that are neighbours in the parent too.
template <int B>
void CopySeparators(const double* parent, int ldp, const std::vector<int>& rows_in_parent, double* Sigma_SS, int ld) {
  const int blocks = static_cast<int>(rows_in_parent.size());
  for (int j = 0; j < blocks; ++j) {
    const double* from = parent + At(rows_in_parent[At(j)]) * At(ldp);
    double* to = Sigma_SS + At(j * B) * At(ld);
    for (int i = 0; i < blocks;) {
      const int row = rows_in_parent[At(i)];
      int end = i + 1;
      while (end < blocks && rows_in_parent[At(end)] == row + (end - i) * B) ++end;
      for (int c = 0; c < B; ++c) {
        std::copy_n(from + At(c) * At(ldp) + At(row), (end - i) * B, to + At(c) * At(ld) + At(i * B));
      }
      i = end;
    }
  }
}

}  // namespace

template <int B>
void ComputeFrontCovariance(const typename BlockCholesky<B>::Front& front, const double* parent, int ldp,
                            const std::vector<int>& rows_in_parent, bool diagonal_only, double* Sigma,
                            FrontScratch& scratch) {
  const DenseKernels& kernels = Kernels();
  const int ld = front.Rows(), p = front.Columns(), s = ld - 1 - p, n = p + s;
  const auto at = [n](int row, int column) { return At(column) * At(n) + At(row); };
  InverseTransposed(front.panel.data(), ld, p, scratch.V, scratch.corner);
  const double* V = scratch.V.data();
  if (s > 0) {
    CopySeparators<B>(parent, ldp, rows_in_parent, Sigma + at(p, p), n);
    Reserve(scratch.K, At(p) * At(s));
    Reserve(scratch.M, At(p) * At(s));
    // K' = L_PP^-T L_SP' (p x s).
    for (int r0 = 0; r0 < p; r0 += kChunk) {
      const int rows = std::min(kChunk, p - r0);
      kernels.set_rectangle(scratch.K.data() + r0, p, V + At(r0) * At(p) + At(r0), p,
                            front.panel.data() + At(r0) * At(ld) + At(p), ld, rows, s, p - r0);
    }
    // -Sigma_PS = K' Sigma_SS.
    kernels.set_rectangle(scratch.M.data(), p, scratch.K.data(), p, Sigma + at(p, p), n, p, s, s);
  }
  // Sigma_PP = V V' + K' Sigma_SS K; rows r0.. of V begin at column r0. Squares on the diagonal are all that is needed
  // if diagonal_only.
  const int chunk = diagonal_only ? kCorner : kChunk;
  for (int r0 = 0; r0 < p; r0 += chunk) {
    const int rows = std::min(chunk, p - r0), c0 = diagonal_only ? r0 : 0, columns = r0 + rows - c0;
    kernels.set_rectangle(Sigma + at(r0, c0), n, V + At(r0) * At(p) + At(r0), p, V + At(r0) * At(p) + At(c0), p, rows,
                          columns, p - r0);
    if (s > 0) {
      kernels.add_rectangle(Sigma + at(r0, c0), n, scratch.M.data() + r0, p, scratch.K.data() + c0, p, rows, columns,
                            s);
    }
  }
  // The same to the last bit on both sides of the diagonal.
  for (int c = 0; c < p; ++c) {
    const int end = diagonal_only ? (c / B + 1) * B : p;
    for (int r = c + 1; r < end; ++r) Sigma[at(c, r)] = Sigma[at(r, c)];
  }
  if (diagonal_only) return;
  for (int j = 0; j < s; ++j) {
    const double* column = scratch.M.data() + At(j) * At(p);
    double* above = Sigma + at(0, p + j);
    for (int i = 0; i < p; ++i) above[i] = -column[i];
  }
  // Its transpose, in squares that stay in the first-level cache.
  constexpr int kSquare = 16;
  for (int j0 = 0; j0 < s; j0 += kSquare) {
    for (int i = 0; i < p; ++i) {
      for (int j = j0; j < std::min(s, j0 + kSquare); ++j) {
        Sigma[at(p + j, i)] = -scratch.M[At(j) * At(p) + At(i)];
      }
    }
  }
}

template <int B>
void ComputeAllDiagonals(const BlockCholesky<B>& factor, std::vector<Matrix<B, B>>& out, RecursionScratch& scratch) {
  out.resize(At(factor.Variables()));
  std::vector<RecursionLevel>& path = scratch.path;
  std::size_t depth = 0;  // levels in use; those below keep their buffers
  const auto visit = [&](int id, const std::vector<int>& rows) {
    if (path.size() == depth) path.emplace_back();
    RecursionLevel& here = path[depth];
    const auto& front = factor.FrontAt(id);
    const int n = here.n = front.Rows() - 1;
    here.front = id;
    here.next_child = 0;
    if (here.covariance.size() < At(n) * At(n)) here.covariance.resize(At(n) * At(n));
    const RecursionLevel* parent = depth > 0 ? &path[depth - 1] : nullptr;
    ComputeFrontCovariance<B>(front, parent ? parent->covariance.data() : nullptr, parent ? parent->n : 0, rows,
                              front.children.empty(), here.covariance.data(), scratch.front);
    const Eigen::Map<const MatrixX> Sigma(here.covariance.data(), n, n);
    Eigen::Index at = 0;
    for (const int v : front.pivots) {
      out[At(v)] = Sigma.block<B, B>(at, at);
      at += B;
    }
    ++depth;
    if (front.children.empty()) return;
    SetRows<B>(front, factor.Variables(), scratch.front);
    here.rows.resize(front.children.size());
    for (std::size_t k = 0; k < front.children.size(); ++k) {
      SeparatorRows<B>(factor.FrontAt(front.children[k]), scratch.front, here.rows[k]);
    }
  };
  for (const int root : factor.Roots()) {
    visit(root, {});
    while (depth > 0) {
      RecursionLevel& top = path[depth - 1];
      const auto& children = factor.FrontAt(top.front).children;
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

template void ComputeAllDiagonals<3>(const BlockCholesky<3>&, std::vector<Matrix<3, 3>>&, RecursionScratch&);
template void ComputeAllDiagonals<6>(const BlockCholesky<6>&, std::vector<Matrix<6, 6>>&, RecursionScratch&);
template void ComputeFrontCovariance<3>(const BlockCholesky<3>::Front&, const double*, int, const std::vector<int>&,
                                        bool, double*, FrontScratch&);
template void ComputeFrontCovariance<6>(const BlockCholesky<6>::Front&, const double*, int, const std::vector<int>&,
                                        bool, double*, FrontScratch&);

}  // namespace terse::internal
