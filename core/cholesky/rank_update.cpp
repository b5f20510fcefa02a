#include "cholesky/rank_update.h"

#include <algorithm>
#include <cmath>

#include "terse/core/dense_kernels.h"
#include "terse/core/state_file.h"

namespace terse::internal {
namespace {

using std::size_t;

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

template <int B>
bool CanAppend(const UpdateContext<B>& update) {
  const BlockSystem<B>& system = update.system;
  const int old_variables = update.undo.variables, added = system.Variables() - old_variables;
  if (old_variables == 0 || added == 0 || !update.undo.replaced.empty() || !update.undo.removed.empty()) return false;
  if (static_cast<int>(update.undo.added.size()) != added) return false;
  for (int v = old_variables; v < system.Variables(); ++v) {
    int joining = 0;
    for (const int slot : system.SlotsOf(v)) {
      const LinearFactor<B>& f = system.LinearFactorAt(slot);
      if (f.second < 0) return false;
      if (std::max(f.first, f.second) != v) continue;
      if (!IsWellConditioned<B>(f.first == v ? f.A_first : f.A_second)) return false;
      ++joining;
    }
    if (joining != 1) return false;
  }
  return true;
}

template <int B>
int Append(UpdateContext<B>& update) {
  const BlockSystem<B>& system = update.system;
  const int old_variables = update.undo.variables;
  std::vector<Front<B>> leaves;
  std::vector<int> parents;  // as FrontTree::Append takes them
  for (int v = old_variables; v < system.Variables(); ++v) {
    Front<B> front;
    front.pivots = {v};
    for (const int slot : system.SlotsOf(v)) {
      const LinearFactor<B>& f = system.LinearFactorAt(slot);
      if (std::max(f.first, f.second) != v) continue;
      front.slots = {slot};
      front.separators = {std::min(f.first, f.second)};
    }
    const int up = front.separators.front();
    parents.push_back(up < old_variables ? update.tree.FrontOf(up) : -1 - (up - old_variables));
    front.ordered_rows = front.Rows();
    front.ordered_columns = front.Columns();
    front.panel.SetBuffer(FrontBuffer(At(front.Rows()) * B));
    front.update.resize((B + 1) * (B + 1));
    const int failed = update.numbers.Factor(front, {}, system, update.tree);
    if (failed >= 0) return failed;
    for (int c = 0; c < B; ++c) update.report.flops += std::pow(front.Rows() - c, 2);
    std::fill(front.update.begin(), front.update.end(), 0.0);  // but for rounding it is
    leaves.push_back(std::move(front));
  }
  update.report.fronts = update.report.variables = static_cast<int>(leaves.size());
  update.tree.Append(leaves, parents, update.version);
  update.report.path = CholeskyPath::kAppended;
  return -1;
}

template <int B>
bool RankUpdate<B>::Plan(const UpdateContext<B>& update, const std::vector<int>& affected, Path& path) {
  const BlockSystem<B>& system = update.system;
  const FrontTree<B>& tree = update.tree;
  const int old_variables = update.undo.variables;
  if (affected.empty() || update.undo.added.empty()) return false;
  if (!update.undo.replaced.empty() || !update.undo.removed.empty()) return false;
  // Bottom-up: a front follows when all its affected children are there.
  position_.resize(At(tree.Size()), 0);
  for (const int f : affected) position_[At(f)] = 0;
  int roots = 0;
  for (const int f : affected) {
    const int parent = tree[f].parent;
    if (parent >= 0) ++position_[At(parent)];
    roots += parent < 0 ? 1 : 0;
  }
  if (roots != 1) return false;
  for (const int f : affected) {
    if (position_[At(f)] == 0) path.fronts.push_back(f);
  }
  for (size_t k = 0; k < path.fronts.size(); ++k) {
    const int parent = tree[path.fronts[k]].parent;
    if (parent >= 0 && --position_[At(parent)] == 0) path.fronts.push_back(parent);
  }
  for (size_t k = 0; k < path.fronts.size(); ++k) position_[At(path.fronts[k])] = static_cast<int>(k);
  const int root = path.fronts.back();
  const auto front_of = [&](int v) { return v < old_variables ? tree.FrontOf(v) : root; };
  const auto is_above = [&](int up, int f) {
    bool is_found = false;
    tree.Climb(f, [&](int at) {
      is_found = at == up;
      return !is_found && position_[At(at)] < position_[At(up)];
    });
    return is_found;
  };
  std::vector<char> held(At(system.Variables() - old_variables), 0);
  for (const int slot : update.undo.added) {
    const LinearFactor<B>& f = system.LinearFactorAt(slot);
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
  return true;
}

template <int B>
bool RankUpdate<B>::IsCheaper(const FrontTree<B>& tree, Path& path) const {
  double update = 0, refactor = 0;
  std::vector<int> columns(path.fronts.size(), 0);
  for (const auto& start : path.starts) columns[At(start.first)] += B;
  for (size_t k = 0; k < path.fronts.size(); ++k) {
    const Front<B>& front = tree[path.fronts[k]];
    const double rows = front.Rows(), p = front.Columns(), s = rows - p;
    update += kRankFlop * columns[k] * (4 * Entries(rows, p) + s * s) + kFront;
    path.excess += kRankFlop * 4 * columns[k] * (Entries(rows, p) - Entries(front.ordered_rows, front.ordered_columns));
    refactor += front.RefactorFlops() + kAssembledEntry * rows * rows + kFront +
                kVariable * static_cast<double>(front.pivots.size());
    if (front.parent >= 0) columns[At(position_[At(front.parent)])] += columns[k];
  }
  return update + debt_ <= refactor;
}

// The columns from `first` on become the factor of L L' + W W'. Returns the variable at which that fails, or -1.
template <int B>
int RankUpdate<B>::ResumeRoot(Front<B>& front, int first, const double* W, int columns, BufferPool& pool) {
  const int rows = front.Rows(), t = front.Columns() - first, n = rows - first;
  FrontBuffer L = pool.Take(At(n) * At(t)), C = pool.Take(At(n) * At(n));
  std::fill_n(C.begin(), At(n) * At(n), 0.0);
  const auto panel = [&](int c) { return front.Entry(first, first + c); };
  for (int c = 0; c < t; ++c) {
    std::fill_n(L.data() + At(c) * At(n), c, 0.0);
    std::copy_n(panel(c) + c, n - c, L.data() + At(c) * At(n) + At(c));
  }
  const auto& kernels = Kernels();
  kernels.subtract_product(C.data(), n, L.data(), L.data(), n, n, n, t);
  kernels.subtract_product(C.data(), n, W + first, W + first, rows, n, n, columns);
  for (int c = 0; c < t; ++c) {
    for (int r = c; r < n; ++r) C[At(c) * At(n) + At(r)] *= -1;
  }
  const int failed = kernels.factor_panel(C.data(), n, n, t);
  for (int c = 0; c < t; ++c) std::copy_n(C.data() + At(c) * At(n) + At(c), n - c, panel(c) + c);
  for (FrontBuffer* buffer : {&L, &C}) {
    pool.MakeRoom(buffer->size());
    pool.Give(std::move(*buffer));
  }
  return failed >= 0 ? front.pivots[At((first + failed) / B)] : -1;
}

// The variables of a front of the path as it will be, their rows in RowOf(), and how many columns W has there.
template <int B>
int RankUpdate<B>::PlaceVariables(Front<B>& front, const Front<B>& old, const Below& below, UpdateContext<B>& update) {
  std::vector<int>& row_of = update.numbers.RowOf();
  front.pivots = old.pivots;
  front.separators = old.separators;
  ++stamp_;
  int row = 0;
  const auto place = [&](int v) {
    row_of[At(v)] = std::exchange(row, row + B);
    stamp_of_[At(v)] = stamp_;
  };
  for (const int v : front.pivots) place(v);
  for (const int v : front.separators) place(v);
  const bool is_root = old.parent < 0;
  const auto add = [&](int v) {
    if (stamp_of_[At(v)] == stamp_) return;
    place(v);
    (is_root ? front.pivots : front.separators).push_back(v);
  };
  if (is_root) {
    for (int v = update.undo.variables; v < update.system.Variables(); ++v) add(v);
  }
  int columns = 0;
  for (const Front<B>* child : below) {
    for (const int v : child->separators) add(v);
    columns += child->corrections.front().columns;
  }
  for (const int slot : front.slots) {
    const LinearFactor<B>& f = update.system.LinearFactorAt(slot);
    add(f.first);
    if (f.second >= 0) add(f.second);
    columns += B;
  }
  return columns;
}

// W, which has the panel's rows: what comes from below and the linear factors that start here. Returns the first row
// that is not zero, or that of y.
template <int B>
int RankUpdate<B>::FillColumns(const Front<B>& front, const Below& below, UpdateContext<B>& update,
                               FrontBuffer& W) const {
  const std::vector<int>& row_of = update.numbers.RowOf();
  const int rows = front.Rows();
  int first = front.Columns();
  double* to = W.data();
  for (const Front<B>* child : below) {
    const Correction& c = child->corrections.front();
    const size_t n = At(B * c.separators + 1);
    for (int k = 0; k < c.columns; ++k, to += rows) {
      const double* from = c.W.data() + At(k) * n;
      for (int i = 0; i < c.separators; ++i) {
        const int at = row_of[At(child->separators[At(i)])];
        first = std::min(first, at);
        std::copy_n(from + i * B, B, to + at);
      }
      to[rows - 1] = from[n - 1];
    }
  }
  for (const int slot : front.slots) {
    const LinearFactor<B>& f = update.system.LinearFactorAt(slot);
    for (int k = 0; k < B; ++k, to += rows) {
      const auto scatter = [&](int v, const Matrix<B, B>& A) {
        const int at = row_of[At(v)];
        first = std::min(first, at);
        for (int c = 0; c < B; ++c) to[at + c] = A(k, c);
      };
      scatter(f.first, f.A_first);
      if (f.second >= 0) scatter(f.second, f.A_second);
      to[rows - 1] = -f.residual[k];
    }
  }
  return first;
}

// The panel in a buffer of its own, with rows and columns for what came in.
template <int B>
void RankUpdate<B>::WidenPanel(Front<B>& front, const Front<B>& old, BufferPool& pool) {
  const int rows = front.Rows(), p = front.Columns(), old_rows = old.Rows(), old_p = old.Columns();
  front.panel.SetBuffer(pool.Take(At(rows) * At(p)));
  for (int c = 0; c < p; ++c) {
    double* column = front.Entry(0, c);
    if (c >= old_p) {
      std::fill(column + c, column + rows, 0.0);
      continue;
    }
    const double* from = old.Entry(0, c);
    std::copy(from + c, from + old_rows - 1, column + c);
    std::fill(column + old_rows - 1, column + rows - 1, 0.0);
    column[rows - 1] = from[old_rows - 1];
  }
}

// One front of the path: its variables, panel and sums as they will be, and the correction that goes on; front.slots
// are the new ones only. `below` are the changed children.
template <int B>
int RankUpdate<B>::UpdateFront(const Front<B>& old, Front<B>& front, const Below& below, UpdateContext<B>& update) {
  BufferPool& pool = update.numbers.Pool();
  const int columns = PlaceVariables(front, old, below, update);
  const int rows = front.Rows(), p = front.Columns();
  FrontBuffer W = pool.Take(At(rows) * At(columns));
  std::fill_n(W.begin(), At(rows) * At(columns), 0.0);
  const int first = FillColumns(front, below, update, W);
  WidenPanel(front, old, pool);
  // Above the root nobody asks for W any more, so it may be factored again from the first changed column on.
  const double update_flops = 4 * columns * Entries(rows - first, p - first);
  const double resume_flops = 4 * std::pow(rows - first, 3) / 3 + columns * std::pow(rows - first, 2);
  if (old.parent < 0 && resume_flops < kRankFlop * update_flops) {
    update.report.flops += resume_flops;
    const int failed = ResumeRoot(front, first, W.data(), columns, pool);
    if (failed >= 0) return failed;
  } else {
    update.report.flops += update_flops;
    Kernels().rank_update(front.Entry(first, first), rows, rows - first, p - first, W.data() + first, rows, columns);
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
  pool.MakeRoom(W.size());
  pool.Give(std::move(W));
  pool.MakeRoom(old.panel.Size());
  return FrontFactorization<B>::SumPivots(front, old.Columns(), update.system);
}

template <int B>
int RankUpdate<B>::Update(const Path& path, UpdateContext<B>& update) {
  FrontTree<B>& tree = update.tree;
  const int variables = update.system.Variables();
  stamp_of_.resize(At(variables), 0);
  std::vector<Front<B>> changed(path.fronts.size());
  std::vector<Below> below(path.fronts.size());
  for (const auto& start : path.starts) changed[At(start.first)].slots.push_back(start.second);
  for (size_t k = 0; k < changed.size(); ++k) {
    const int id = path.fronts[k];
    const int failed = UpdateFront(tree[id], changed[k], below[k], update);
    if (failed >= 0) return failed;
    if (tree[id].parent >= 0) below[At(position_[At(tree[id].parent)])].push_back(&changed[k]);
    tree.MakeRoom(id, changed[k]);
  }
  for (const int id : path.fronts) {
    int waiting = 0;
    for (const Correction& c : tree[id].corrections) waiting += c.columns;
    if (waiting > kMostColumns) update.numbers.WorkInCorrections(tree[id]);
  }
  for (size_t k = 0; k < changed.size(); ++k) {
    tree.Exchange(path.fronts[k], std::move(changed[k]), update.version, update.numbers.Pool());
  }
  tree.SetFrontOf(update.undo.variables, variables, path.fronts.back());
  debt_ += path.excess;
  update.report.fronts_updated = static_cast<int>(changed.size());
  update.report.path = CholeskyPath::kRankUpdate;
  return -1;
}

template <int B>
template <class Archive>
void RankUpdate<B>::Serialize(Archive& archive) {
  auto& [position, stamp_of, stamp, debt] = *this;  // the rest is scratch
  archive(debt);
}

#define TERSE_INSTANTIATE(B)                            \
  template bool CanAppend<B>(const UpdateContext<B>&);  \
  template int Append<B>(UpdateContext<B>&);            \
  template class RankUpdate<B>;                         \
  template void RankUpdate<B>::Serialize(StateWriter&); \
  template void RankUpdate<B>::Serialize(StateReader&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
