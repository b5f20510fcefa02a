#include "terse/core/block_cholesky.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "dense_kernels.h"
#include "elimination.h"
#include "stopwatch.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

template <int B>
using BlockMap = Eigen::Map<Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;
template <int B>
using ConstBlockMap = Eigen::Map<const Eigen::Matrix<double, B, B>, Eigen::Unaligned, Eigen::OuterStride<>>;

// The stored block (row, column) of a front, in the panel or in the update matrix.
template <int B>
BlockMap<B> Target(typename BlockCholesky<B>::Front& front, int row, int column) {
  const int p = front.Columns(), rows = front.Rows();
  if (column < p) {
    return BlockMap<B>(front.panel.data() + At(column) * At(rows) + At(row), Eigen::OuterStride<>(rows));
  }
  const int n = rows - p;
  return BlockMap<B>(front.update.data() + At(column - p) * At(n) + At(row - p), Eigen::OuterStride<>(n));
}

// The right-hand side's entries of a variable at `column`; `stride` apart.
template <int B>
double* RightHandSide(typename BlockCholesky<B>::Front& front, int column, int& stride) {
  const int p = front.Columns(), rows = front.Rows(), n = rows - p;
  stride = column < p ? rows : n;
  return column < p ? front.panel.data() + At(column) * At(rows) + At(rows - 1)
                    : front.update.data() + At(column - p) * At(n) + At(n - 1);
}

}  // namespace

// What ApplyFactors did, so that a failed update can be taken back.
template <int B>
struct BlockCholesky<B>::Undo {
  int variables = 0;
  std::vector<int> added;
  std::vector<std::pair<int, LinearFactor<B>>> replaced, removed;
};

template <int B>
void BlockCholesky<B>::Attach(int slot) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v < 0) continue;
    auto& list = slots_of_[At(v)];
    list.insert(std::lower_bound(list.begin(), list.end(), slot), slot);
  }
}

template <int B>
void BlockCholesky<B>::Detach(int slot) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v < 0) continue;
    auto& list = slots_of_[At(v)];
    list.erase(std::lower_bound(list.begin(), list.end(), slot));
  }
}

template <int B>
void BlockCholesky<B>::ApplyFactors(Changes& changes, std::vector<int>& added_slots, Undo& undo) {
  undo.variables = Variables();
  const size_t total = front_of_.size() + At(changes.new_variables);
  front_of_.resize(total, -1);
  slots_of_.resize(total);
  row_of_.resize(total, -1);
  solution_.resize(total * B, 0.0);
  for (const int slot : changes.removed) {
    Detach(slot);
    undo.removed.emplace_back(slot, factors_[At(slot)]);
    factors_[At(slot)].first = -1;
  }
  for (auto& [slot, factor] : changes.replaced) {
    undo.replaced.emplace_back(slot, factors_[At(slot)]);
    factors_[At(slot)] = factor;
  }
  for (LinearFactor<B>& factor : changes.added) {
    int slot = static_cast<int>(factors_.size());
    if (free_slots_.empty()) {
      factors_.push_back(factor);
    } else {
      slot = free_slots_.back();
      free_slots_.pop_back();
      factors_[At(slot)] = factor;
    }
    Attach(slot);
    undo.added.push_back(slot);
    added_slots.push_back(slot);
  }
  free_slots_.insert(free_slots_.end(), changes.removed.begin(), changes.removed.end());
}

template <int B>
void BlockCholesky<B>::RevertFactors(const Undo& undo) {
  free_slots_.resize(free_slots_.size() - undo.removed.size());
  for (auto it = undo.added.rbegin(); it != undo.added.rend(); ++it) {
    Detach(*it);
    factors_[At(*it)].first = -1;
    free_slots_.push_back(*it);
  }
  for (const auto& [slot, factor] : undo.replaced) factors_[At(slot)] = factor;
  for (const auto& [slot, factor] : undo.removed) {
    factors_[At(slot)] = factor;
    Attach(slot);
  }
  const size_t total = At(undo.variables);
  front_of_.resize(total);
  slots_of_.resize(total);
  row_of_.resize(total);
  solution_.resize(total * B);
}

// Fronts of the touched variables and their ancestors, children before parents.
template <int B>
std::vector<int> BlockCholesky<B>::AffectedFronts(const Changes& changes) const {
  std::vector<char> seen(fronts_.size(), 0);
  std::vector<int> affected;
  const auto touch = [&](int variable) {
    if (variable < 0) return;
    for (int f = front_of_[At(variable)]; f >= 0 && seen[At(f)] == 0; f = fronts_[At(f)].parent) {
      seen[At(f)] = 1;
      affected.push_back(f);
    }
  };
  const auto touch_factor = [&](const LinearFactor<B>& factor) {
    touch(factor.first);
    touch(factor.second);
  };
  for (const auto& factor : changes.added) touch_factor(factor);
  for (const auto& change : changes.replaced) touch_factor(factors_[At(change.first)]);
  for (const int slot : changes.removed) touch_factor(factors_[At(slot)]);
  return affected;
}

template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(Changes changes) {
  UpdateReport report;
  for (const int slot : changes.removed) {
    if (slot < 0 || At(slot) >= factors_.size() || factors_[At(slot)].first < 0)
      throw std::invalid_argument("no such factor slot");
  }
  const int old_variables = Variables();
  // Variables of new factors' fronts are found before the factors are applied; new ones have no front yet.
  for (const auto& f : changes.added) {
    if (f.first < 0 || f.first >= old_variables + changes.new_variables ||
        f.second >= old_variables + changes.new_variables) {
      throw std::invalid_argument("a factor names an unknown variable");
    }
  }
  std::vector<int> order_last_variables;
  for (const auto& f : changes.added) {
    order_last_variables.push_back(f.first);
    if (f.second >= 0) order_last_variables.push_back(f.second);
  }
  front_of_.resize(At(old_variables) + At(changes.new_variables), -1);
  const std::vector<int> affected = AffectedFronts(changes);
  front_of_.resize(At(old_variables));
  Undo undo;
  ApplyFactors(changes, report.added_slots, undo);

  // The affected variables, their factors, and the separators of the subtrees that stay.
  std::vector<int> variables, local(front_of_.size(), -1);
  const auto take = [&](int v) {
    local[At(v)] = static_cast<int>(variables.size());
    variables.push_back(v);
  };
  std::vector<char> is_affected(fronts_.size(), 0);
  for (const int f : affected) is_affected[At(f)] = 1;
  for (const int f : affected) {
    for (const int v : fronts_[At(f)].pivots) take(v);
  }
  for (int v = old_variables; v < Variables(); ++v) take(v);
  internal::Cliques cliques;
  std::vector<int> clique_slot, clique_orphan;
  for (const int v : variables) {
    for (const int slot : slots_of_[At(v)]) {
      const LinearFactor<B>& f = factors_[At(slot)];
      const int other = f.first == v ? f.second : f.first;
      // A factor reaching below belongs to a front that stays; one between two affected is taken once.
      if (other >= 0 && (local[At(other)] < 0 || (f.first != v))) continue;
      cliques.members.push_back(local[At(v)]);
      if (other >= 0) cliques.members.push_back(local[At(other)]);
      cliques.Close();
      clique_slot.push_back(slot);
      clique_orphan.push_back(-1);
    }
  }
  for (const int f : affected) {
    for (const int child : fronts_[At(f)].children) {
      if (is_affected[At(child)] != 0) continue;
      for (const int v : fronts_[At(child)].separators) cliques.members.push_back(local[At(v)]);
      cliques.Close();
      clique_slot.push_back(-1);
      clique_orphan.push_back(child);
    }
  }
  std::vector<char> order_last(variables.size(), 0);
  if (!affected.empty()) {
    for (const int v : order_last_variables) order_last[At(local[At(v)])] = 1;
  }
  std::vector<internal::SymbolicFront> symbolic;
  try {
    internal::ScopedTimer timer(report.seconds_order);
    symbolic = internal::Eliminate(static_cast<int>(variables.size()), cliques, order_last);
  } catch (...) {
    RevertFactors(undo);
    throw;
  }

  // Ids of the new fronts: free ones first. Old fronts stay until the numbers have worked out.
  std::vector<Front> pending(symbolic.size());
  std::vector<int> id_of(symbolic.size());
  size_t reused = 0, appended = fronts_.size();
  for (size_t k = 0; k < symbolic.size(); ++k) {
    id_of[k] =
        reused < free_fronts_.size() ? free_fronts_[free_fronts_.size() - ++reused] : static_cast<int>(appended++);
  }
  std::vector<std::vector<int>> new_children(symbolic.size());  // indices into pending
  for (size_t k = 0; k < symbolic.size(); ++k) {
    Front& front = pending[k];
    front.parent = symbolic[k].parent;  // pending index for now
    for (const int l : symbolic[k].pivots) front.pivots.push_back(variables[At(l)]);
    for (const int l : symbolic[k].separators) front.separators.push_back(variables[At(l)]);
    for (const int c : symbolic[k].cliques) {
      if (clique_slot[At(c)] >= 0) {
        front.slots.push_back(clique_slot[At(c)]);
      } else {
        front.children.push_back(clique_orphan[At(c)]);
      }
    }
    if (front.parent >= 0) new_children[At(front.parent)].push_back(static_cast<int>(k));
  }
  for (size_t k = 0; k < symbolic.size(); ++k) {
    Front& front = pending[k];
    // Orphans are in fronts_, new children in pending: FactorFront tells them apart by sign.
    for (const int child : new_children[k]) front.children.push_back(-1 - child);
    const int failed = FactorFront(front, pending, {});
    if (failed >= 0) {
      report.failed_variable = failed;
      report.added_slots.clear();
      RevertFactors(undo);
      return report;
    }
    for (int& child : front.children) {
      if (child < 0) child = id_of[At(-1 - child)];
    }
    report.variables += static_cast<int>(front.pivots.size());
    for (int c = 0; c < front.Columns(); ++c) {
      const double rows = front.Rows() - c;
      report.flops += rows * rows;
    }
  }

  // Commit.
  for (const int f : affected) {
    fronts_[At(f)] = Front();
    free_fronts_.push_back(f);
  }
  const size_t freed = affected.size();
  free_fronts_.erase(free_fronts_.end() - static_cast<long>(freed + reused),
                     free_fronts_.end() - static_cast<long>(freed));
  fronts_.resize(appended);
  roots_.erase(std::remove_if(roots_.begin(), roots_.end(),
                              [&](int f) { return At(f) < is_affected.size() && is_affected[At(f)] != 0; }),
               roots_.end());
  for (size_t k = 0; k < pending.size(); ++k) {
    Front& front = pending[k];
    front.parent = front.parent >= 0 ? id_of[At(front.parent)] : -1;
    if (front.parent < 0) roots_.push_back(id_of[k]);
    for (const int v : front.pivots) front_of_[At(v)] = id_of[k];
    fronts_[At(id_of[k])] = std::move(front);
  }
  for (size_t k = 0; k < pending.size(); ++k) {
    for (const int child : fronts_[At(id_of[k])].children) fronts_[At(child)].parent = id_of[k];
  }
  report.fronts = static_cast<int>(pending.size());
  report.ok = true;
  ++version_;
  return report;
}

template <int B>
void BlockCholesky<B>::SetFactor(int slot, const LinearFactor<B>& factor) {
  LinearFactor<B>& old = factors_.at(At(slot));
  if (old.first != factor.first || old.second != factor.second)
    throw std::invalid_argument("a factor may not change its variables");
  old = factor;
}

template <int B>
bool BlockCholesky<B>::Refactor(const std::vector<double>& damping) {
  ++version_;
  std::vector<int> order = TopDown();
  for (auto it = order.rbegin(); it != order.rend(); ++it) {
    if (FactorFront(fronts_[At(*it)], {}, damping) >= 0) return false;
  }
  return true;
}

// Returns the variable at which the matrix was found not to be positive definite, or -1.
template <int B>
int BlockCholesky<B>::FactorFront(Front& front, const std::vector<Front>& pending, const std::vector<double>& damping) {
  const int rows = front.Rows(), p = front.Columns(), n = rows - p;
  front.panel.assign(At(rows) * At(p), 0.0);
  front.update.assign(At(n) * At(n), 0.0);
  int row = 0;
  for (const int v : front.pivots) row_of_[At(v)] = std::exchange(row, row + B);
  for (const int v : front.separators) row_of_[At(v)] = std::exchange(row, row + B);
  for (const int slot : front.slots) AssembleFactor(front, factors_[At(slot)]);
  front.subtree_log_det = front.subtree_y2 = 0;
  for (const int child : front.children) {
    const Front& c = child < 0 ? pending[At(-1 - child)] : fronts_[At(child)];
    AssembleChild(front, c);
    front.subtree_log_det += c.subtree_log_det;
    front.subtree_y2 += c.subtree_y2;
  }
  if (!damping.empty()) {
    for (int c = 0; c < p; ++c) {
      front.panel[At(c) * At(rows) + At(c)] += damping[At(front.pivots[At(c / B)]) * B + At(c % B)];
    }
  }
  const int failed = internal::Kernels().factor_panel(front.panel.data(), rows, p);
  if (failed >= 0) return front.pivots[At(failed / B)];
  internal::Kernels().subtract_outer(front.update.data(), n, front.panel.data(), rows, p);
  for (int c = 0; c < p; ++c) {
    front.subtree_log_det += 2 * std::log(front.panel[At(c) * At(rows) + At(c)]);
    const double y = front.panel[At(c) * At(rows) + At(rows - 1)];
    front.subtree_y2 += y * y;
  }
  front.fresh = true;
  return -1;
}

template <int B>
void BlockCholesky<B>::AssembleFactor(Front& front, const LinearFactor<B>& f) {
  int stride = 0;
  const auto add_variable = [&](int variable, const Matrix<B, B>& A) {
    const int at = row_of_[At(variable)];
    Target<B>(front, at, at).noalias() += A.transpose() * A;
    double* b = RightHandSide<B>(front, at, stride);
    const Vector<B> rhs = -(A.transpose() * f.residual);
    for (int k = 0; k < B; ++k) b[k * stride] += rhs[k];
  };
  add_variable(f.first, f.A_first);
  if (f.second < 0) return;
  add_variable(f.second, f.A_second);
  const int i = row_of_[At(f.first)], j = row_of_[At(f.second)];
  if (i > j) {
    Target<B>(front, i, j).noalias() += f.A_first.transpose() * f.A_second;
  } else {
    Target<B>(front, j, i).noalias() += f.A_second.transpose() * f.A_first;
  }
}

// Extend-add of a child's update matrix. A kept child's separator order may be stale: its ancestors were ordered
// again since, so a block can land transposed.
template <int B>
void BlockCholesky<B>::AssembleChild(Front& front, const Front& child) {
  const int blocks = static_cast<int>(child.separators.size());
  const int n = blocks * B + 1;
  for (int j = 0; j < blocks; ++j) {
    const int cj = row_of_[At(child.separators[At(j)])];
    const double* column = child.update.data() + At(j * B) * At(n);
    for (int i = j; i < blocks; ++i) {
      const int ci = row_of_[At(child.separators[At(i)])];
      const ConstBlockMap<B> source(column + i * B, Eigen::OuterStride<>(n));
      if (ci >= cj) {
        Target<B>(front, ci, cj) += source;
      } else {
        Target<B>(front, cj, ci) += source.transpose();
      }
    }
    int stride = 0;
    double* b = RightHandSide<B>(front, cj, stride);
    for (int k = 0; k < B; ++k) b[k * stride] += column[At(k) * At(n) + At(n - 1)];
  }
}

// Fronts with parents before children.
template <int B>
std::vector<int> BlockCholesky<B>::TopDown() const {
  std::vector<int> order(roots_);
  for (size_t k = 0; k < order.size(); ++k) {
    const auto& children = fronts_[At(order[k])].children;
    order.insert(order.end(), children.begin(), children.end());
  }
  return order;
}

template <int B>
std::vector<int> BlockCholesky<B>::Solve(double threshold) {
  std::vector<char> moved(front_of_.size(), 0);
  std::vector<int> changed, stack(roots_);
  Eigen::VectorXd x;
  while (!stack.empty()) {
    Front& front = fronts_[At(stack.back())];
    stack.pop_back();
    const auto is_moved = [&](int v) { return moved[At(v)] != 0; };
    if (!front.fresh && std::none_of(front.separators.begin(), front.separators.end(), is_moved)) {
      // Nothing changed here; a refactored front has refactored ancestors, so none is below.
      continue;
    }
    front.fresh = false;
    stack.insert(stack.end(), front.children.begin(), front.children.end());
    const int rows = front.Rows(), p = front.Columns();
    const Eigen::Map<const Eigen::MatrixXd> L(front.panel.data(), rows, p);
    x = L.row(rows - 1).transpose();
    int row = p;
    for (const int v : front.separators) {
      const Eigen::Map<const Eigen::Matrix<double, B, 1>> xs(solution_.data() + At(v) * B);
      x.noalias() -= L.middleRows<B>(row).transpose() * xs;
      row += B;
    }
    L.topRows(p).template triangularView<Eigen::Lower>().transpose().solveInPlace(x);
    for (size_t k = 0; k < front.pivots.size(); ++k) {
      const int v = front.pivots[k];
      Eigen::Map<Eigen::Matrix<double, B, 1>> old(solution_.data() + At(v) * B);
      const auto value = x.segment<B>(static_cast<Eigen::Index>(k) * B);
      if ((value - old).cwiseAbs().maxCoeff() <= threshold) continue;
      old = value;
      moved[At(v)] = 1;
      changed.push_back(v);
    }
  }
  return changed;
}

template <int B>
void BlockCholesky<B>::ClearSolution(int variable) {
  std::fill_n(solution_.begin() + static_cast<long>(variable) * B, B, 0.0);
}

template <int B>
double BlockCholesky<B>::LogDeterminant() const {
  double sum = 0;
  for (const int f : roots_) sum += fronts_[At(f)].subtree_log_det;
  return sum;
}

template <int B>
double BlockCholesky<B>::NewtonDecrement() const {
  double sum = 0;
  for (const int f : roots_) sum += fronts_[At(f)].subtree_y2;
  return sum;
}

template <int B>
std::vector<double> BlockCholesky<B>::Gradient() const {
  std::vector<double> b(front_of_.size() * B, 0.0);
  const auto add = [&](int v, const Matrix<B, B>& A, const Vector<B>& r) {
    Eigen::Map<Vector<B>>(b.data() + At(v) * B) -= A.transpose() * r;
  };
  for (const auto& f : factors_) {
    if (f.first < 0) continue;
    add(f.first, f.A_first, f.residual);
    if (f.second >= 0) add(f.second, f.A_second, f.residual);
  }
  return b;
}

template <int B>
std::vector<double> BlockCholesky<B>::Diagonal() const {
  std::vector<double> d(front_of_.size() * B, 0.0);
  const auto add = [&](int v, const Matrix<B, B>& A) {
    Eigen::Map<Vector<B>>(d.data() + At(v) * B) += A.colwise().squaredNorm().transpose();
  };
  for (const auto& f : factors_) {
    if (f.first < 0) continue;
    add(f.first, f.A_first);
    if (f.second >= 0) add(f.second, f.A_second);
  }
  return d;
}

template <int B>
std::int64_t BlockCholesky<B>::FactorNonzeros() const {
  std::int64_t sum = 0;
  for (const auto& front : fronts_) {
    const std::int64_t p = front.Columns(), rows = front.pivots.empty() ? 0 : front.Rows() - 1;
    sum += p * rows - p * (p - 1) / 2;
  }
  return sum;
}

template class BlockCholesky<3>;
template class BlockCholesky<6>;

}  // namespace terse
