// The touched part of the tree, ordered and factored again.

#include <algorithm>

#include "cholesky/block_cholesky_parts.h"
#include "support/stopwatch.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// So many times the entries of a fresh ordering are too many, in a graph of so many variables.
constexpr double kDrift = 1.5;
constexpr int kLeastDrifting = 100;

}  // namespace

// Fronts of the touched variables and their ancestors. Marks them.
template <int B>
void BlockCholesky<B>::AffectedFronts(const Undo& undo, std::vector<int>& affected) {
  is_affected_.resize(fronts_.size(), 0);
  undo.VisitVariables(factors_, [&](int variable) {
    for (int f = front_of_[At(variable)]; f >= 0 && is_affected_[At(f)] == 0; f = fronts_[At(f)].parent) {
      affected.push_back(f);
      is_affected_[At(f)] = 1;
    }
  });
}

// Calls visit(slot) for the factors between the region's variables, by first variable and slot. A factor that reaches
// below belongs to a front that stays, and most factors of a hub may be of that kind; where there are many, those that
// are wanted come out of the fronts.
template <int B>
template <class Visit>
void BlockCholesky<B>::ForEachSlot(const Region& region, const Visit& visit) const {
  size_t on_variables = 0, in_fronts = 0;
  for (const int v : region.variables) on_variables += slots_of_[At(v)].size();
  for (const int f : region.fronts) in_fronts += fronts_[At(f)].slots.size();
  if (region.added == nullptr || on_variables <= kHub || on_variables <= 4 * (in_fronts + region.added->size())) {
    for (const int v : region.variables) {
      for (const int slot : slots_of_[At(v)]) {
        const LinearFactor<B>& f = factors_[At(slot)];
        if (f.first == v && (f.second < 0 || local_[At(f.second)] >= 0)) visit(slot);
      }
    }
    return;
  }
  std::vector<std::pair<int, int>> wanted;  // (index of the first variable, slot)
  const auto want = [&](int slot) {
    const int first = factors_[At(slot)].first;
    if (first >= 0) wanted.emplace_back(local_[At(first)], slot);
  };
  for (const int f : region.fronts) std::for_each(fronts_[At(f)].slots.begin(), fronts_[At(f)].slots.end(), want);
  std::for_each(region.added->begin(), region.added->end(), want);
  std::sort(wanted.begin(), wanted.end());
  for (const auto& entry : wanted) visit(entry.second);
}

// Variables, factors and orphaned separators of the affected fronts and the new variables. Fills local_.
template <int B>
void BlockCholesky<B>::CollectCliques(int old_variables, Region& region) {
  local_.resize(front_of_.size(), -1);
  const auto take = [&](int v) {
    local_[At(v)] = static_cast<int>(region.variables.size());
    region.variables.push_back(v);
  };
  for (const int f : region.fronts) {
    for (const int v : fronts_[At(f)].pivots) take(v);
  }
  for (int v = old_variables; v < Variables(); ++v) take(v);
  const auto close = [&](int slot, int orphan) {
    region.cliques.Close();
    region.slot.push_back(slot);
    region.orphan.push_back(orphan);
  };
  ForEachSlot(region, [&](int slot) {
    const LinearFactor<B>& f = factors_[At(slot)];
    region.cliques.members.push_back(local_[At(f.first)]);
    if (f.second >= 0) region.cliques.members.push_back(local_[At(f.second)]);
    close(slot, -1);
  });
  for (const int f : region.fronts) {
    for (const int child : fronts_[At(f)].children) {
      if (is_affected_[At(child)] != 0) continue;
      for (const int v : fronts_[At(child)].separators) region.cliques.members.push_back(local_[At(v)]);
      close(-1, child);
    }
  }
}

// New fronts, children before parents. Parents are indices into the result, and so are children -1 - k; children
// that are not negative are fronts that stay.
template <int B>
std::vector<typename BlockCholesky<B>::Front> BlockCholesky<B>::MakeFronts(const Region& region) const {
  const auto symbolic =
      internal::Eliminate(static_cast<int>(region.variables.size()), region.cliques, region.order_last);
  std::vector<Front> pending(symbolic.size());
  for (size_t k = 0; k < symbolic.size(); ++k) {
    Front& front = pending[k];
    front.parent = symbolic[k].parent;
    for (const int l : symbolic[k].pivots) front.pivots.push_back(region.variables[At(l)]);
    for (const int l : symbolic[k].separators) front.separators.push_back(region.variables[At(l)]);
    front.ordered_rows = front.Rows();
    front.ordered_columns = front.Columns();
    for (const int c : symbolic[k].cliques) {
      if (region.slot[At(c)] >= 0) {
        front.slots.push_back(region.slot[At(c)]);
      } else {
        front.children.push_back(region.orphan[At(c)]);
      }
    }
    if (front.parent >= 0) pending[At(front.parent)].children.push_back(-1 - static_cast<int>(k));
  }
  return pending;
}

// Returns the variable at which the new fronts turn out not to be positive definite, or -1.
template <int B>
int BlockCholesky<B>::FactorPending(std::vector<Front>& pending, UpdateReport& report) {
  std::vector<Front*> fronts;
  std::vector<int> parents;
  for (Front& front : pending) {
    fronts.push_back(&front);
    parents.push_back(front.parent);
  }
  return FactorFronts(fronts, parents, pending, {}, report.flops);
}

// The pending fronts take the place of the affected ones. All memory was reserved before.
template <int B>
void BlockCholesky<B>::Replace(const std::vector<int>& affected, std::vector<Front>& pending,
                               std::vector<int>& id_of) noexcept {
  const auto gone = [&](int f) { return is_affected_[At(f)] != 0; };
  roots_.erase(std::remove_if(roots_.begin(), roots_.end(), gone), roots_.end());
  for (const int f : affected) {
    Front& front = fronts_[At(f)];
    log_det_ -= front.log_det;
    y2_ -= front.y2;
    pool_.Give(std::move(front.panel));
    pool_.Give(std::move(front.update));
    front = Front();
    free_fronts_.push_back(f);
  }
  for (int& id : id_of) {
    if (free_fronts_.empty()) {
      id = static_cast<int>(fronts_.size());
      fronts_.emplace_back();
    } else {
      id = free_fronts_.back();
      free_fronts_.pop_back();
    }
  }
  for (size_t k = 0; k < pending.size(); ++k) {
    Front& front = fronts_[At(id_of[k])] = std::move(pending[k]);
    log_det_ += front.log_det;
    y2_ += front.y2;
    front.stamp = next_version_;
    front.parent = front.parent >= 0 ? id_of[At(front.parent)] : -1;
    if (front.parent < 0) roots_.push_back(id_of[k]);
    for (const int v : front.pivots) front_of_[At(v)] = id_of[k];
    for (int& child : front.children) {
      if (child < 0) child = id_of[At(-1 - child)];
      fronts_[At(child)].parent = id_of[k];
    }
  }
}

// Whether a fresh ordering of everything would have far fewer entries. Looked at when the graph has doubled.
template <int B>
bool BlockCholesky<B>::HasDrifted(int old_variables, Region& all) {
  if (old_variables < kLeastDrifting || old_variables < 2 * drift_looked_at_) return false;
  drift_looked_at_ = old_variables;
  AllFronts(all.fronts);
  CollectCliques(old_variables, all);
  all.order_last.assign(all.variables.size(), 0);
  double fresh = 0;
  for (const auto& front : internal::Eliminate(static_cast<int>(all.variables.size()), all.cliques, all.order_last)) {
    const double p = B * static_cast<double>(front.pivots.size()), s = B * static_cast<double>(front.separators.size());
    fresh += p * (p + 1) / 2 + p * s;
  }
  Forget(all);
  all = Region();
  return static_cast<double>(FactorNonzeros()) > kDrift * fresh;
}

// Removes the marks.
template <int B>
void BlockCholesky<B>::Forget(const Region& region) {
  for (const int f : region.fronts) is_affected_[At(f)] = 0;
  for (const int v : region.variables) local_[At(v)] = -1;
}

// Marks them.
template <int B>
void BlockCholesky<B>::AllFronts(std::vector<int>& fronts) {
  fronts = TopDown();
  is_affected_.resize(fronts_.size(), 0);
  for (const int f : fronts) is_affected_[At(f)] = 1;
}

// Returns the variable at which the matrix turns out not to be positive definite, or -1.
template <int B>
int BlockCholesky<B>::RefactorRegion(int old_variables, const Undo& undo, Region& region, UpdateReport& report) {
  std::vector<Front> pending;
  {
    internal::ScopedTimer timer(report.seconds_order);
    region.added = &undo.added;
    CollectCliques(old_variables, region);
    region.order_last.assign(region.variables.size(), 0);
    const auto last = [&](int v) {
      if (v >= 0 && local_[At(v)] >= 0) region.order_last[At(local_[At(v)])] = 1;
    };
    if (!region.fronts.empty()) {  // where everything is new, nothing is newest
      for (const int slot : undo.added) {
        last(factors_[At(slot)].first);
        last(factors_[At(slot)].second);
      }
      last(Variables() - 1);
    }
    pending = MakeFronts(region);
  }
  for (const int child : region.orphan) {
    if (child >= 0) WorkInCorrections(fronts_[At(child)]);
  }
  const int failed = FactorPending(pending, report);
  if (failed >= 0) return failed;
  std::vector<int> id_of(pending.size());
  internal::ReserveMore(roots_, pending.size());
  internal::ReserveMore(free_fronts_, region.fronts.size());
  internal::ReserveMore(fronts_, pending.size());
  for (const int f : region.fronts) {
    pool_.MakeRoom(fronts_[At(f)].panel.size());
    pool_.MakeRoom(fronts_[At(f)].update.size());
  }
  report.fronts = static_cast<int>(pending.size());
  report.variables = static_cast<int>(region.variables.size());
  report.path = FactorPath::kRefactored;
  Replace(region.fronts, pending, id_of);
  debt_ = 0;
  return -1;
}

#define TERSE_INSTANTIATE(B)                                                                                \
  template void BlockCholesky<B>::AffectedFronts(const Undo&, std::vector<int>&);                           \
  template bool BlockCholesky<B>::HasDrifted(int, Region&);                                                 \
  template void BlockCholesky<B>::Forget(const Region&);                                                    \
  template void BlockCholesky<B>::AllFronts(std::vector<int>&);                                             \
  template void BlockCholesky<B>::CollectCliques(int, Region&);                                             \
  template std::vector<BlockCholesky<B>::Front> BlockCholesky<B>::MakeFronts(const Region&) const;          \
  template int BlockCholesky<B>::FactorPending(std::vector<Front>&, UpdateReport&);                         \
  template void BlockCholesky<B>::Replace(const std::vector<int>&, std::vector<Front>&, std::vector<int>&); \
  template int BlockCholesky<B>::RefactorRegion(int, const Undo&, Region&, UpdateReport&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
