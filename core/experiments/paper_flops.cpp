#include "terse/core/paper_flops.h"
#include "terse/core/at.h"

#include <colamd.h>

#include <algorithm>
#include <cstdlib>
#include <numeric>
#include <stdexcept>

namespace terse::internal {
namespace {

using std::size_t;

// A symmetric pattern by columns, both triangles, rows ascending.
struct Pattern {
  std::vector<int> start, rows;
  int Columns() const { return static_cast<int>(start.size()) - 1; }
};

// Position and rotation of a variable.
template <int B>
struct Parts {
  static constexpr int kCount = 2;
  static constexpr int kBegin[] = {0, B == 3 ? 2 : 3, B};
};

template <int B>
Pattern PatternOf(const BlockCholesky<B>& factor) {
  using P = Parts<B>;
  const int variables = factor.Variables();
  std::vector<std::vector<int>> coupled(At(P::kCount * variables));  // parts, without themselves
  const auto couple = [&](int v, const Matrix<B, B>& A, int w, const Matrix<B, B>& C) {
    const Matrix<B, B> product = A.transpose() * C;
    for (int a = 0; a < P::kCount; ++a) {
      for (int c = 0; c < P::kCount; ++c) {
        const bool zero =
            product.block(P::kBegin[a], P::kBegin[c], P::kBegin[a + 1] - P::kBegin[a], P::kBegin[c + 1] - P::kBegin[c])
                .isZero(0);
        const int i = P::kCount * v + a, j = P::kCount * w + c;
        if (zero || i == j) continue;
        coupled[At(i)].push_back(j);
        if (v != w) coupled[At(j)].push_back(i);
      }
    }
  };
  for (int v = 0; v < variables; ++v) {
    for (const int slot : factor.SlotsOf(v)) {
      const LinearFactor<B>& f = factor.LinearFactorAt(slot);
      if (f.first != v) continue;
      couple(f.first, f.A_first, f.first, f.A_first);
      if (f.second < 0) continue;
      couple(f.second, f.A_second, f.second, f.A_second);
      couple(f.first, f.A_first, f.second, f.A_second);
    }
  }
  Pattern pattern;
  pattern.start.push_back(0);
  for (int part = 0; part < P::kCount * variables; ++part) {
    auto& others = coupled[At(part)];
    others.push_back(part);
    std::sort(others.begin(), others.end());
    others.erase(std::unique(others.begin(), others.end()), others.end());
    const int which = part % P::kCount;
    for (int k = P::kBegin[which]; k < P::kBegin[which + 1]; ++k) {
      for (const int other : others) {
        const int base = B * (other / P::kCount), end = P::kBegin[other % P::kCount + 1];
        for (int row = P::kBegin[other % P::kCount]; row < end; ++row) pattern.rows.push_back(base + row);
      }
      pattern.start.push_back(static_cast<int>(pattern.rows.size()));
    }
  }
  return pattern;
}

// Elimination order, first to last.
std::vector<int> OrderScalars(Pattern& pattern) {
  const int n = pattern.Columns();
  std::vector<int> order(At(n) + 1);
  double knobs[COLAMD_KNOBS];
  colamd_set_defaults(knobs);
  int stats[COLAMD_STATS];
  if (symamd(n, pattern.rows.data(), pattern.start.data(), order.data(), knobs, stats, &std::calloc, &std::free) == 0) {
    throw std::logic_error("ordering failed");
  }
  order.pop_back();
  return order;
}

// Elimination tree of the pattern in this order, and the entries of each row of L, the diagonal included: the row's
// subtree (Liu 1990). All by position in the order.
struct Symbolic {
  std::vector<int> parent, row_count;
};

Symbolic Analyse(const Pattern& pattern, const std::vector<int>& order) {
  const int n = pattern.Columns();
  Symbolic out{std::vector<int>(At(n), -1), std::vector<int>(At(n), 1)};
  std::vector<int> position(At(n)), mark(At(n), -1);
  for (int k = 0; k < n; ++k) position[At(order[At(k)])] = k;
  for (int k = 0; k < n; ++k) {
    const int scalar = order[At(k)];
    mark[At(k)] = k;
    for (int p = pattern.start[At(scalar)]; p < pattern.start[At(scalar) + 1]; ++p) {
      for (int j = position[At(pattern.rows[At(p)])]; j < k && mark[At(j)] != k; j = out.parent[At(j)]) {
        mark[At(j)] = k;
        ++out.row_count[At(k)];
        if (out.parent[At(j)] >= 0) continue;
        out.parent[At(j)] = k;
        break;
      }
    }
  }
  return out;
}

// Positions so that every subtree is contiguous, children in ascending order.
std::vector<int> PostOrder(const std::vector<int>& parent) {
  const int n = static_cast<int>(parent.size());
  std::vector<int> first(At(n) + 1, -1), next(At(n), -1), out, stack;
  for (int k = n - 1; k >= 0; --k) {
    const size_t up = At(parent[At(k)] < 0 ? n : parent[At(k)]);
    next[At(k)] = first[up];
    first[up] = k;
  }
  for (int root = first[At(n)]; root >= 0; root = next[At(root)]) {
    stack.push_back(root);
    while (!stack.empty()) {
      const int k = stack.back(), child = first[At(k)];
      if (child >= 0) {
        first[At(k)] = next[At(child)];
        stack.push_back(child);
      } else {
        out.push_back(k);
        stack.pop_back();
      }
    }
  }
  return out;
}

double Sum(const std::vector<double>& values, const std::vector<int>& at) {
  double sum = 0;
  for (const int v : at) sum += values[At(v)];
  return sum;
}

}  // namespace

template <int B>
PaperFlops::PaperFlops(const BlockCholesky<B>& factor)
    : kappa_(At(factor.Variables()), 0.0), kappa2_(At(factor.Variables()), 0.0) {
  Pattern pattern = PatternOf(factor);
  const Symbolic symbolic = Analyse(pattern, OrderScalars(pattern));
  const std::vector<int> post = PostOrder(symbolic.parent);
  for (size_t k = 0; k < post.size(); ++k) {
    const double kappa = symbolic.row_count[At(post[k])];
    kappa_[k / B] += kappa;
    kappa2_[k / B] += kappa * kappa;
  }
}

double PaperFlops::Added(int first_new) const {
  return std::accumulate(kappa2_.begin() + first_new, kappa2_.end(), 0.0);
}
double PaperFlops::Updated() const { return Added(0); }
double PaperFlops::Updated(const std::vector<int>& variables) const {
  return std::min(2 * Sum(kappa2_, variables), Updated());
}
double PaperFlops::Solved() const { return 2 * std::accumulate(kappa_.begin(), kappa_.end(), 0.0); }
double PaperFlops::Solved(const std::vector<int>& variables) const { return 2 * Sum(kappa_, variables); }

template <class Pose>
void PaperFlopsMeter<Pose>::Count(const PointWork& work) {
  switch (work.kind) {
    case PointWork::Kind::kEntered:
      paper_ = PaperFlops(solver_->Cholesky());
      flops_ = {paper_.Added(work.first), 0};
      break;
    case PointWork::Kind::kSolved: flops_.solve += work.poses ? paper_.Solved(*work.poses) : paper_.Solved(); break;
    case PointWork::Kind::kRelinearised:
      flops_.update += work.poses ? paper_.Updated(*work.poses) : paper_.Updated();
      break;
  }
}

template class PaperFlopsMeter<SE2>;
template class PaperFlopsMeter<SE3>;
template PaperFlops::PaperFlops(const BlockCholesky<3>&);
template PaperFlops::PaperFlops(const BlockCholesky<6>&);

}  // namespace terse::internal
