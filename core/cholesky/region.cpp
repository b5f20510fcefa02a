#include "cholesky/region.h"

#include <algorithm>
#include <functional>

#include "support/stopwatch.h"
#include "terse/core/front_paths.h"
#include "terse/core/state_file.h"

namespace terse::internal {
namespace {

using std::size_t;

// Paths so many times as long as those of a fresh order are too long, in a graph of so many variables.
constexpr double kDrift = 1.5;
constexpr int kLeastDrifting = 100;
// The work between two looks, in factorisations of everything, each with flops for the order of a variable.
constexpr double kLook = 16;
constexpr double kOrderFlops = 2e4;
// So many times as much where a look takes too long for a step.
constexpr double kRarely = 8;
// So many times the flops of when the fronts were ordered are too many.
constexpr double kGrown = 1.25;

template <int B>
FactorCost CostOf(const FrontTree<B>& tree) {
  FactorCost cost;
  std::vector<double> path(At(tree.Size()));
  for (const int f : tree.TopDown()) {
    const Front<B>& front = tree[f];
    path[At(f)] = cost.Add(static_cast<double>(front.pivots.size()), static_cast<double>(front.separators.size()),
                           front.parent >= 0 ? path[At(front.parent)] : 0.0);
  }
  return cost;
}

}  // namespace

template <int B>
void Region<B>::TakeAffected(const UpdateContext<B>& update) {
  is_taken_.resize(At(update.tree.Size()), 0);
  update.undo.VisitVariables(update.system, [&](int variable) {
    update.tree.Climb(update.tree.FrontOf(variable), [&](int f) {
      if (is_taken_[At(f)] != 0) return false;
      fronts_.push_back(f);
      is_taken_[At(f)] = 1;
      return true;
    });
  });
}

template <int B>
std::vector<int> Region<B>::TakeAffectedBut(const UpdateContext<B>& update, const Preparation<B>& prepared) {
  TakeAffected(update);
  const auto is_ready = [&](int f) { return prepared.IsReady(f, update.tree); };
  const auto ready = std::stable_partition(fronts_.begin(), fronts_.end(), std::not_fn(is_ready));
  std::vector<int> out(ready, fronts_.end());
  fronts_.erase(ready, fronts_.end());
  for (const int f : out) is_taken_[At(f)] = 0;
  return out;
}

template <int B>
void Region<B>::TakeAll(const FrontTree<B>& tree) {
  is_taken_.resize(At(tree.Size()), 0);
  fronts_ = tree.TopDown();
  for (const int f : fronts_) is_taken_[At(f)] = 1;
}

template <int B>
bool Region<B>::TakeAllIfDrifted(const UpdateContext<B>& update) {
  if (update.undo.variables < kLeastDrifting || watch_.work < watch_.next_look) return false;
  ScopedTimer timer(update.report.seconds_order);
  const FactorCost now = CostOf(update.tree);
  const double flops = B * B * B * now.flops + kOrderFlops * update.tree.Variables();
  watch_ = {0, kLook * (most_flops_ > 0 && flops > most_flops_ ? kRarely : 1) * flops};
  TakeAll(update.tree);
  ordered_ = Order(update);
  if (now.paths > kDrift * CostOf(ordered_->fronts).paths) return true;
  Clear();
  return false;
}

template <int B>
void Region<B>::Clear() noexcept {
  for (const int f : fronts_) is_taken_[At(f)] = 0;
  for (const int v : variables_) local_[At(v)] = -1;
  fronts_.clear();
  variables_.clear();
  ordered_.reset();
}

// Calls visit(slot) for the linear factors between the region's variables, by first variable and slot. One that reaches
// below belongs to a front that stays, and most of a hub may be of that kind; where there are many, those that are
// wanted come out of the fronts.
template <int B>
template <class Visit>
void Region<B>::ForEachSlot(const UpdateContext<B>& update, const Visit& visit) const {
  const BlockSystem<B>& system = update.system;
  const std::vector<int>& added = update.undo.added;
  size_t on_variables = 0, in_fronts = 0;
  for (const int v : variables_) on_variables += system.SlotsOf(v).size();
  for (const int f : fronts_) in_fronts += update.tree[f].slots.size();
  if (on_variables <= BlockSystem<B>::kHub || on_variables <= 4 * (in_fronts + added.size())) {
    for (const int v : variables_) {
      for (const int slot : system.SlotsOf(v)) {
        const LinearFactor<B>& f = system.LinearFactorAt(slot);
        if (f.first == v && (f.second < 0 || local_[At(f.second)] >= 0)) visit(slot);
      }
    }
    return;
  }
  std::vector<std::pair<int, int>> wanted;  // (index of the first variable, slot)
  const auto want = [&](int slot) {
    const int first = system.LinearFactorAt(slot).first;
    if (first >= 0) wanted.emplace_back(local_[At(first)], slot);
  };
  for (const int f : fronts_) std::for_each(update.tree[f].slots.begin(), update.tree[f].slots.end(), want);
  std::for_each(added.begin(), added.end(), want);
  std::sort(wanted.begin(), wanted.end());
  for (const auto& entry : wanted) visit(entry.second);
}

// Of what was taken and the new variables, which it lists.
template <int B>
typename Region<B>::Couplings Region<B>::Collect(const UpdateContext<B>& update) {
  local_.resize(At(update.system.Variables()), -1);
  const auto take = [&](int v) {
    variables_.push_back(v);
    local_[At(v)] = static_cast<int>(variables_.size()) - 1;
  };
  for (const int f : fronts_) {
    for (const int v : update.tree[f].pivots) take(v);
  }
  for (int v = update.undo.variables; v < update.system.Variables(); ++v) take(v);
  Couplings out;
  const auto close = [&](int slot, int orphan) {
    out.cliques.Close();
    out.slot.push_back(slot);
    out.orphan.push_back(orphan);
  };
  ForEachSlot(update, [&](int slot) {
    const LinearFactor<B>& f = update.system.LinearFactorAt(slot);
    out.cliques.members.push_back(local_[At(f.first)]);
    if (f.second >= 0) out.cliques.members.push_back(local_[At(f.second)]);
    close(slot, -1);
  });
  for (const int f : fronts_) {
    for (const int child : update.tree[f].children) {
      if (is_taken_[At(child)] != 0) continue;
      for (const int v : update.tree[child].separators) out.cliques.members.push_back(local_[At(v)]);
      close(-1, child);
    }
  }
  out.order_last.assign(variables_.size(), 0);
  return out;
}

template <int B>
void Region<B>::OrderNewestLast(const UpdateContext<B>& update, Couplings& couplings) const {
  if (fronts_.empty()) return;  // where everything is new, nothing is newest
  const auto last = [&](int v) {
    if (v >= 0 && local_[At(v)] >= 0) couplings.order_last[At(local_[At(v)])] = 1;
  };
  for (const int slot : update.undo.added) {
    last(update.system.LinearFactorAt(slot).first);
    last(update.system.LinearFactorAt(slot).second);
  }
  last(update.system.Variables() - 1);
}

template <int B>
typename Region<B>::Couplings Region<B>::Order(const UpdateContext<B>& update) {
  Couplings out = Collect(update);
  if (update.undo.variables == 0 && first_order_.size() == variables_.size() && !variables_.empty()) {
    out.fronts = EliminateInOrder(out.cliques, first_order_);
    return out;
  }
  OrderNewestLast(update, out);
  out.fronts = Eliminate(static_cast<int>(variables_.size()), out.cliques, out.order_last,
                         fronts_.empty() ? OrderFor::kSolving : OrderFor::kUpdates);
  return out;
}

// As FrontTree::Replace takes them.
template <int B>
std::vector<Front<B>> Region<B>::MakeFronts(const Couplings& couplings) const {
  const std::vector<SymbolicFront>& symbolic = couplings.fronts;
  std::vector<Front<B>> pending(symbolic.size());
  for (size_t k = 0; k < symbolic.size(); ++k) {
    Front<B>& front = pending[k];
    front.parent = symbolic[k].parent;
    for (const int l : symbolic[k].pivots) front.pivots.push_back(variables_[At(l)]);
    for (const int l : symbolic[k].separators) front.separators.push_back(variables_[At(l)]);
    front.ordered_rows = front.Rows();
    front.ordered_columns = front.Columns();
    for (const int c : symbolic[k].cliques) {
      if (couplings.slot[At(c)] >= 0) {
        front.slots.push_back(couplings.slot[At(c)]);
      } else {
        front.children.push_back(couplings.orphan[At(c)]);
      }
    }
    if (front.parent >= 0) pending[At(front.parent)].children.push_back(-1 - static_cast<int>(k));
  }
  return pending;
}

template <int B>
int Region<B>::Refactor(UpdateContext<B>& update) {
  std::vector<Front<B>> pending;
  std::vector<int> orphans;
  {
    ScopedTimer timer(update.report.seconds_order);
    if (!ordered_) ordered_ = Order(update);
    pending = MakeFronts(*ordered_);
    orphans = std::move(ordered_->orphan);
  }
  for (const int child : orphans) {
    if (child >= 0) update.numbers.WorkInCorrections(update.tree[child]);
  }
  std::vector<Front<B>*> fronts;
  std::vector<int> parents;
  for (Front<B>& front : pending) {
    fronts.push_back(&front);
    parents.push_back(front.parent);
  }
  const int failed =
      update.numbers.FactorAll(fronts, parents, pending, update.system, update.tree, {}, update.report.flops);
  if (failed >= 0) return failed;
  update.report.fronts = static_cast<int>(pending.size());
  update.report.variables = static_cast<int>(variables_.size());
  update.report.path = CholeskyPath::kRefactored;
  update.tree.Replace(fronts_, is_taken_, pending, update.version, update.numbers.Pool());
  return -1;
}

template <int B>
bool Region<B>::IsOutOfOrder(const FrontTree<B>& tree) const {
  if (ordered_) return true;
  double now = 0, ordered = 0;
  for (const int f : fronts_) {
    now += tree[f].RefactorFlops();
    const double rows = tree[f].ordered_rows - 1, below = rows - tree[f].ordered_columns;
    ordered += (rows * rows * rows - below * below * below) / 3;
  }
  return now > kGrown * ordered;
}

template <int B>
int Region<B>::RefactorAsOrdered(UpdateContext<B>& update) {
  if (fronts_.empty()) return -1;
  FrontTree<B>& tree = update.tree;
  FrontPaths<B> paths(tree);  // all that was taken
  for (const int f : fronts_) paths.Add(tree[f].pivots.front());
  const int count = paths.Size();
  const auto place = [&](int front) { return paths.Find(front) < 0 ? -1 : count - 1 - paths.Find(front); };
  std::vector<Front<B>> pending(At(count));
  std::vector<Front<B>*> fronts;
  std::vector<int> parents;
  for (int k = 0; k < count; ++k) {
    const Front<B>& now = paths[count - 1 - k];
    Front<B>& front = pending[At(k)];
    update.numbers.CopyShape(paths.IdAt(count - 1 - k), place, tree, front);
    fronts.push_back(&front);
    parents.push_back(now.parent < 0 ? -1 : place(now.parent));
    update.report.variables += static_cast<int>(now.pivots.size());
    update.numbers.Pool().MakeRoom(now.panel.Size());
    update.numbers.Pool().MakeRoom(now.update.size());
  }
  const int failed = update.numbers.FactorAll(fronts, parents, pending, update.system, tree, {}, update.report.flops);
  if (failed >= 0) return failed;
  update.report.fronts = count;
  update.report.path = CholeskyPath::kRefactored;
  for (int k = 0; k < count; ++k) {
    Front<B>& old = pending[At(k)];
    tree.ExchangeNumbers(paths.IdAt(count - 1 - k), old, update.version);
    update.numbers.Pool().Give(old.panel.TakeBuffer());
    update.numbers.Pool().Give(std::move(old.update));
  }
  return -1;
}

// Between updates nothing is taken; the limit is set again by who has one.
template <int B>
template <class Archive>
void Region<B>::Serialize(Archive& archive) {
  auto& [fronts, variables, is_taken, local, ordered, watch, most_flops, first_order] = *this;
  archive(watch.work, watch.next_look);
}

template <int B>
std::string Region<B>::FindStateDefect() const {
  return watch_.work >= 0 && watch_.next_look >= 0 ? "" : "the factor took less than no work";
}

#define TERSE_INSTANTIATE(B)                        \
  template class Region<B>;                         \
  template void Region<B>::Serialize(StateWriter&); \
  template void Region<B>::Serialize(StateReader&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
