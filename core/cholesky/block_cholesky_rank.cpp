// Bringing the tree up to date without factoring it again: new leaves, and rank-k updates along the paths.
//
// With augmented rows a = [A, -r], H = sum a'a and y ride along as the panel's last row. A front takes W, k columns
// over its variables and the right-hand side: [L, W] Q = [L~, W~], W~ zero on the pivots; its update matrix grows by
// W~_S W~_S', and W~_S goes on to the parent.

#include <algorithm>
#include <cmath>

#include "cholesky/block_cholesky_parts.h"
#include "terse/core/dense_kernels.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// Measured on fronts of 60 to 500 scalars: a flop of the rank-k kernel takes about as long as so many of the
// factorisation, and so many flops' time goes into each entry that is assembled, each front, each variable ordered.
constexpr double kRankFlop = 2.5, kAssembledEntry = 6, kFront = 2e4, kVariable = 2e4;
// Corrections are worked into an update matrix when they have grown to this many columns.
constexpr int kMostColumns = 48;

double Entries(double rows, double pivots) { return pivots * rows - pivots * (pivots - 1) / 2; }

template <int B>
bool IsWellConditioned(const Matrix<B, B>& A) {
  const Eigen::LLT<Matrix<B, B>> llt(A.transpose() * A);
  if (llt.info() != Eigen::Success) return false;
  const Vector<B> diagonal = llt.matrixLLT().diagonal();
  return diagonal.minCoeff() > 1e-6 * diagonal.maxCoeff();
}

}  // namespace

// A front on the path as it will be: its variables, panel and sums; of corrections and slots the new ones only.
template <int B>
struct BlockCholesky<B>::Changed {
  int id = 0;
  Front front;
};

// New variables that a single factor each joins to an older one: what is there does not change, because the factor
// can be met exactly.
template <int B>
bool BlockCholesky<B>::PlanAppend(const Changes& changes, int old_variables,
                                  const std::vector<int>& added_slots) const {
  if (method_ == Method::kRefactor || old_variables == 0 || changes.new_variables == 0) return false;
  if (!changes.replaced.empty() || !changes.removed.empty()) return false;
  if (static_cast<int>(added_slots.size()) != changes.new_variables) return false;
  for (int v = old_variables; v < Variables(); ++v) {
    int joining = 0;
    for (const int slot : slots_of_[At(v)]) {
      const LinearFactor<B>& f = factors_[At(slot)];
      if (f.second < 0) return false;
      if (std::max(f.first, f.second) != v) continue;
      if (!IsWellConditioned<B>(f.first == v ? f.A_first : f.A_second)) return false;
      ++joining;
    }
    if (joining != 1) return false;
  }
  return true;
}

// Returns the variable at which it failed, or -1.
template <int B>
int BlockCholesky<B>::Append(int old_variables, UpdateReport& report) {
  std::vector<Front> pending;
  std::vector<int> parents;  // -1 - k: pending[k]
  for (int v = old_variables; v < Variables(); ++v) {
    Front front;
    front.pivots = {v};
    for (const int slot : slots_of_[At(v)]) {
      const LinearFactor<B>& f = factors_[At(slot)];
      if (std::max(f.first, f.second) != v) continue;
      front.slots = {slot};
      front.separators = {std::min(f.first, f.second)};
    }
    const int up = front.separators.front();
    parents.push_back(up < old_variables ? front_of_[At(up)] : -1 - (up - old_variables));
    front.ordered_rows = front.Rows();
    front.ordered_columns = front.Columns();
    front.panel.resize(At(front.Rows()) * B);
    front.update.resize((B + 1) * (B + 1));
    const int failed = FactorFront(front, {}, {}, row_of_, false);
    if (failed >= 0) return failed;
    for (int c = 0; c < B; ++c) report.flops += std::pow(front.Rows() - c, 2);
    std::fill(front.update.begin(), front.update.end(), 0.0);  // but for rounding it is
    pending.push_back(std::move(front));
  }
  const size_t count = pending.size();
  internal::ReserveMore(fronts_, count);
  internal::ReserveMore(waiting_, count);
  // A front gets its child when all that can fail is done.
  std::vector<int> ids;
  for (const int parent : parents) {
    ids.push_back(static_cast<int>(fronts_.size() + ids.size()));
    if (parent >= 0) internal::ReserveMore(fronts_[At(parent)].children, count);
  }
  for (size_t k = 0; k < count; ++k) {
    if (parents[k] < 0) pending[At(-1 - parents[k])].children.reserve(count);
  }
  for (size_t k = 0; k < count; ++k) {
    Front& front = pending[k];
    front.parent = parents[k] >= 0 ? parents[k] : ids[At(-1 - parents[k])];
    front.stamp = next_version_;
    log_det_ += front.log_det;
    y2_ += front.y2;
    front_of_[At(front.pivots.front())] = ids[k];
    fronts_[At(front.parent)].children.push_back(ids[k]);
    waiting_.push_back(ids[k]);
    fronts_.push_back(std::move(front));
  }
  report.fronts = report.variables = static_cast<int>(count);
  report.path = FactorPath::kAppended;
  return -1;
}

// Whether a rank-k update can take the changes in, and is the cheaper way. Affected fronts are marked.
template <int B>
bool BlockCholesky<B>::PlanRankUpdate(const Changes& changes, int old_variables, const std::vector<int>& affected,
                                      const std::vector<int>& added_slots, RankPath& path) {
  if (method_ == Method::kRefactor || affected.empty() || changes.added.empty()) return false;
  if (!changes.replaced.empty() || !changes.removed.empty()) return false;
  // Bottom-up: a front follows when all its affected children are there.
  position_.resize(fronts_.size(), 0);
  for (const int f : affected) position_[At(f)] = 0;
  int roots = 0;
  for (const int f : affected) {
    const int parent = fronts_[At(f)].parent;
    if (parent >= 0) ++position_[At(parent)];
    roots += parent < 0 ? 1 : 0;
  }
  if (roots != 1) return false;
  for (const int f : affected) {
    if (position_[At(f)] == 0) path.fronts.push_back(f);
  }
  for (size_t k = 0; k < path.fronts.size(); ++k) {
    const int parent = fronts_[At(path.fronts[k])].parent;
    if (parent >= 0 && --position_[At(parent)] == 0) path.fronts.push_back(parent);
  }
  for (size_t k = 0; k < path.fronts.size(); ++k) position_[At(path.fronts[k])] = static_cast<int>(k);
  const int root = path.fronts.back();
  const auto front_of = [&](int v) { return v < old_variables ? front_of_[At(v)] : root; };
  const auto is_above = [&](int up, int f) {
    while (f >= 0 && f != up && position_[At(f)] < position_[At(up)]) f = fronts_[At(f)].parent;
    return f == up;
  };
  std::vector<char> held(At(Variables() - old_variables), 0);
  for (const int slot : added_slots) {
    const LinearFactor<B>& f = factors_[At(slot)];
    int start = front_of(f.first);
    if (f.second >= 0) {
      const int other = front_of(f.second);
      if (is_above(start, other)) {
        start = other;
      } else if (!is_above(other, start)) {
        return false;
      }
    }
    path.starts.emplace_back(position_[At(start)], slot);
    // A new variable must hang on an older one, or nothing may measure some of its directions.
    const int newest = std::max(f.first, f.second), oldest = f.second < 0 ? newest : std::min(f.first, f.second);
    if (newest < old_variables || (oldest == newest ? false : oldest >= old_variables)) continue;
    if (IsWellConditioned<B>(f.first == newest ? f.A_first : f.A_second)) held[At(newest - old_variables)] = 1;
  }
  if (std::find(held.begin(), held.end(), 0) != held.end()) return false;
  std::sort(path.starts.begin(), path.starts.end());
  return method_ == Method::kRankUpdateWherePossible || IsCheaper(path);
}

// Without ordering the path fills up. What that has cost so far counts against the next update, so that it never costs
// more than an ordering would have.
template <int B>
bool BlockCholesky<B>::IsCheaper(const RankPath& path) {
  double update = 0, excess = 0, refactor = 0;
  std::vector<int> columns(path.fronts.size(), 0);
  for (const auto& start : path.starts) columns[At(start.first)] += B;
  for (size_t k = 0; k < path.fronts.size(); ++k) {
    const Front& front = fronts_[At(path.fronts[k])];
    const double rows = front.Rows(), p = front.Columns(), s = rows - p;
    update += kRankFlop * columns[k] * (4 * Entries(rows, p) + s * s) + kFront;
    excess += kRankFlop * 4 * columns[k] * (Entries(rows, p) - Entries(front.ordered_rows, front.ordered_columns));
    refactor += (std::pow(rows, 3) - std::pow(s, 3)) / 3 + kAssembledEntry * rows * rows + kFront +
                kVariable * static_cast<double>(front.pivots.size());
    if (front.parent >= 0) columns[At(position_[At(front.parent)])] += columns[k];
  }
  if (update + debt_ > refactor) return false;
  debt_ += excess;
  return true;
}

// The columns from `first` on become the factor of L L' + W W'. Returns the variable at which that fails, or -1.
template <int B>
int BlockCholesky<B>::ResumeRoot(Front& front, int first, const double* W, int columns) {
  const int rows = front.Rows(), t = front.Columns() - first, n = rows - first;
  std::vector<double> L = pool_.Take(At(n) * At(t)), C = pool_.Take(At(n) * At(n));
  std::fill_n(C.begin(), At(n) * At(n), 0.0);
  const auto panel = [&](int c) { return front.panel.data() + At(first + c) * At(rows) + At(first); };
  for (int c = 0; c < t; ++c) {
    std::fill_n(L.data() + At(c) * At(n), c, 0.0);
    std::copy_n(panel(c) + c, n - c, L.data() + At(c) * At(n) + At(c));
  }
  const auto& kernels = internal::Kernels();
  kernels.subtract_product(C.data(), n, L.data(), L.data(), n, n, n, t);
  kernels.subtract_product(C.data(), n, W + first, W + first, rows, n, n, columns);
  for (int c = 0; c < t; ++c) {
    for (int r = c; r < n; ++r) C[At(c) * At(n) + At(r)] *= -1;
  }
  const int failed = kernels.factor_panel(C.data(), n, n, t);
  for (int c = 0; c < t; ++c) std::copy_n(C.data() + At(c) * At(n) + At(c), n - c, panel(c) + c);
  for (std::vector<double>* buffer : {&L, &C}) {
    pool_.MakeRoom(buffer->size());
    pool_.Give(std::move(*buffer));
  }
  return failed >= 0 ? front.pivots[At((first + failed) / B)] : -1;
}

// One front of the path. `below` are the changed children, `slots` the factors that start here.
template <int B>
int BlockCholesky<B>::RankUpdateFront(Changed& changed, const std::vector<const Front*>& below, int old_variables,
                                      UpdateReport& report) {
  const Front& old = fronts_[At(changed.id)];
  Front& front = changed.front;
  const bool is_root = old.parent < 0;
  front.pivots = old.pivots;
  front.separators = old.separators;
  ++stamp_;
  int row = 0;
  const auto place = [&](int v) {
    row_of_[At(v)] = std::exchange(row, row + B);
    stamp_of_[At(v)] = stamp_;
  };
  for (const int v : front.pivots) place(v);
  for (const int v : front.separators) place(v);
  const auto add = [&](int v) {
    if (stamp_of_[At(v)] == stamp_) return;
    place(v);
    (is_root ? front.pivots : front.separators).push_back(v);
  };
  if (is_root) {
    for (int v = old_variables; v < Variables(); ++v) add(v);
  }
  int columns = 0;
  for (const Front* child : below) {
    for (const int v : child->separators) add(v);
    columns += child->corrections.front().columns;
  }
  for (const int slot : front.slots) {
    add(factors_[At(slot)].first);
    if (factors_[At(slot)].second >= 0) add(factors_[At(slot)].second);
    columns += B;
  }

  const int rows = front.Rows(), p = front.Columns();
  std::vector<double> W = pool_.Take(At(rows) * At(columns));
  std::fill_n(W.begin(), At(rows) * At(columns), 0.0);
  int first = p;  // the first pivot that changes
  double* to = W.data();
  for (const Front* child : below) {
    const Correction& c = child->corrections.front();
    const size_t n = At(B * c.separators + 1);
    for (int k = 0; k < c.columns; ++k, to += rows) {
      const double* from = c.W.data() + At(k) * n;
      for (int i = 0; i < c.separators; ++i) {
        const int at = row_of_[At(child->separators[At(i)])];
        first = std::min(first, at);
        std::copy_n(from + i * B, B, to + at);
      }
      to[rows - 1] = from[n - 1];
    }
  }
  for (const int slot : front.slots) {
    const LinearFactor<B>& f = factors_[At(slot)];
    for (int k = 0; k < B; ++k, to += rows) {
      const auto scatter = [&](int v, const Matrix<B, B>& A) {
        const int at = row_of_[At(v)];
        first = std::min(first, at);
        for (int c = 0; c < B; ++c) to[at + c] = A(k, c);
      };
      scatter(f.first, f.A_first);
      if (f.second >= 0) scatter(f.second, f.A_second);
      to[rows - 1] = -f.residual[k];
    }
  }

  front.panel = pool_.Take(At(rows) * At(p));
  const int old_rows = old.Rows(), old_p = old.Columns();
  for (int c = 0; c < p; ++c) {
    double* column = front.panel.data() + At(c) * At(rows);
    if (c >= old_p) {
      std::fill(column + c, column + rows, 0.0);
      continue;
    }
    const double* from = old.panel.data() + At(c) * At(old_rows);
    std::copy(from + c, from + old_rows - 1, column + c);
    std::fill(column + old_rows - 1, column + rows - 1, 0.0);
    column[rows - 1] = from[old_rows - 1];
  }
  // Above the root nobody asks for W any more, so it may be factored again from the first changed column on.
  const double update_flops = 4 * columns * Entries(rows - first, p - first);
  const double resume_flops = 4 * std::pow(rows - first, 3) / 3 + columns * std::pow(rows - first, 2);
  if (is_root && resume_flops < kRankFlop * update_flops) {
    report.flops += resume_flops;
    const int failed = ResumeRoot(front, first, W.data(), columns);
    if (failed >= 0) return failed;
  } else {
    report.flops += update_flops;
    internal::Kernels().rank_update(front.panel.data() + At(first) * At(rows) + At(first), rows, rows - first,
                                    p - first, W.data() + first, rows, columns);
  }

  Correction correction;
  correction.separators = static_cast<int>(front.separators.size());
  correction.columns = columns;
  const int n = rows - p;
  correction.W.resize(At(n) * At(columns));
  for (int k = 0; k < columns; ++k) {
    std::copy_n(W.data() + At(k) * At(rows) + At(p), n, correction.W.data() + At(k) * At(n));
  }
  front.corrections.push_back(std::move(correction));
  pool_.MakeRoom(W.size());
  pool_.Give(std::move(W));
  pool_.MakeRoom(old.panel.size());
  return SumPivots(front, old_p);
}

// Returns the variable at which the matrix turns out not to be positive definite, or -1. Until then nothing changes.
template <int B>
int BlockCholesky<B>::RankUpdate(const RankPath& path, int old_variables, UpdateReport& report) {
  stamp_of_.resize(At(Variables()), 0);
  std::vector<Changed> changed(path.fronts.size());
  std::vector<std::vector<const Front*>> below(path.fronts.size());
  for (const auto& start : path.starts) changed[At(start.first)].front.slots.push_back(start.second);
  for (size_t k = 0; k < changed.size(); ++k) {
    changed[k].id = path.fronts[k];
    Front& front = fronts_[At(path.fronts[k])];
    int waiting = 0;
    for (const Correction& c : front.corrections) waiting += c.columns;
    if (waiting > kMostColumns) WorkInCorrections(front);
    const int failed = RankUpdateFront(changed[k], below[k], old_variables, report);
    if (failed >= 0) return failed;
    if (front.parent >= 0) below[At(position_[At(front.parent)])].push_back(&changed[k].front);
    internal::ReserveMore(front.corrections, 1);
    internal::ReserveMore(front.slots, changed[k].front.slots.size());
  }
  for (Changed& c : changed) {
    Front& front = fronts_[At(c.id)];
    log_det_ += c.front.log_det - front.log_det;
    y2_ += c.front.y2 - front.y2;
    front.log_det = c.front.log_det;
    front.y2 = c.front.y2;
    front.pivots.swap(c.front.pivots);
    front.separators.swap(c.front.separators);
    front.panel.swap(c.front.panel);
    pool_.Give(std::move(c.front.panel));
    if (front.parent >= 0) front.corrections.push_back(std::move(c.front.corrections.front()));
    front.slots.insert(front.slots.end(), c.front.slots.begin(), c.front.slots.end());
    front.fresh = true;
    front.stamp = next_version_;
  }
  for (int v = old_variables; v < Variables(); ++v) front_of_[At(v)] = path.fronts.back();
  report.fronts_updated = static_cast<int>(changed.size());
  report.path = FactorPath::kRankUpdate;
  return -1;
}

#define TERSE_INSTANTIATE(B)                                                                                      \
  template bool BlockCholesky<B>::PlanAppend(const Changes&, int, const std::vector<int>&) const;                 \
  template int BlockCholesky<B>::Append(int, UpdateReport&);                                                      \
  template bool BlockCholesky<B>::PlanRankUpdate(const Changes&, int, const std::vector<int>&,                    \
                                                 const std::vector<int>&, RankPath&);                             \
  template bool BlockCholesky<B>::IsCheaper(const RankPath&);                                                     \
  template int BlockCholesky<B>::ResumeRoot(Front&, int, const double*, int);                                     \
  template int BlockCholesky<B>::RankUpdateFront(Changed&, const std::vector<const Front*>&, int, UpdateReport&); \
  template int BlockCholesky<B>::RankUpdate(const RankPath&, int, UpdateReport&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
