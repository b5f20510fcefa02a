// Changing the graph: which part of the tree that touches, its new elimination, and taking it back if it fails.

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>

#include "elimination.h"
#include "stopwatch.h"
#include "terse/core/block_cholesky.h"
#include "version.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// Room for `more` elements, growing geometrically as push_back would.
template <class T>
void Reserve(std::vector<T>& v, size_t more) {
  if (v.size() + more > v.capacity()) v.reserve(std::max(v.size() + more, 2 * v.capacity()));
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
    const auto it = std::lower_bound(list.begin(), list.end(), slot);
    if (it != list.end() && *it == slot) list.erase(it);
  }
}

// Leaves `undo` able to take back what was done so far, whatever throws.
template <int B>
void BlockCholesky<B>::ApplyFactors(Changes& changes, std::vector<int>& added_slots, Undo& undo) {
  undo.variables = Variables();
  undo.added.reserve(changes.added.size());
  undo.replaced.reserve(changes.replaced.size());
  undo.removed.reserve(changes.removed.size());
  added_slots.reserve(changes.added.size());
  // Neither committing nor taking back allocates.
  Reserve(free_slots_, changes.added.size() + changes.removed.size());
  const size_t total = front_of_.size() + At(changes.new_variables);
  slots_of_.resize(total);
  row_of_.resize(total, -1);
  solution_.resize(total * B, 0.0);
  front_of_.resize(total, -1);
  for (const int slot : changes.removed) {
    undo.removed.emplace_back(slot, factors_[At(slot)]);
    Detach(slot);
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
    undo.added.push_back(slot);
    added_slots.push_back(slot);
    Attach(slot);
  }
}

template <int B>
void BlockCholesky<B>::RevertFactors(const Undo& undo) {
  for (auto it = undo.added.rbegin(); it != undo.added.rend(); ++it) {
    Detach(*it);
    factors_[At(*it)].first = -1;
    free_slots_.push_back(*it);
  }
  for (const auto& [slot, factor] : undo.replaced) factors_[At(slot)] = factor;
  for (const auto& [slot, factor] : undo.removed) {
    factors_[At(slot)] = factor;
    Attach(slot);  // into lists that had room for it
  }
  const size_t total = At(undo.variables);
  front_of_.resize(total);
  slots_of_.resize(total);
  row_of_.resize(total);
  solution_.resize(total * B);
}

// The touched part of the tree: what is eliminated again, and what that hangs together by.
template <int B>
struct BlockCholesky<B>::Region {
  std::vector<int> fronts;     // the touched variables' and all their ancestors
  std::vector<int> variables;  // their pivots and the new variables
  internal::Cliques cliques;   // in indices of `variables`
  // A clique's origin: a factor, or the separator of a subtree that stays; the other is -1.
  std::vector<int> slot, orphan;
  std::vector<char> order_last;
};

// Fronts of the touched variables and their ancestors. Marks them.
template <int B>
void BlockCholesky<B>::AffectedFronts(const Changes& changes, std::vector<int>& affected) {
  is_affected_.resize(fronts_.size(), 0);
  const auto touch = [&](int variable) {
    if (variable < 0 || variable >= Variables()) return;
    for (int f = front_of_[At(variable)]; f >= 0 && is_affected_[At(f)] == 0; f = fronts_[At(f)].parent) {
      affected.push_back(f);
      is_affected_[At(f)] = 1;
    }
  };
  const auto touch_factor = [&](const LinearFactor<B>& factor) {
    touch(factor.first);
    touch(factor.second);
  };
  for (const auto& factor : changes.added) touch_factor(factor);
  for (const auto& change : changes.replaced) touch_factor(factors_[At(change.first)]);
  for (const int slot : changes.removed) touch_factor(factors_[At(slot)]);
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
  for (const int v : region.variables) {
    for (const int slot : slots_of_[At(v)]) {
      const LinearFactor<B>& f = factors_[At(slot)];
      // A factor that reaches below belongs to a front that stays; one between two affected is taken once.
      if (f.first != v || (f.second >= 0 && local_[At(f.second)] < 0)) continue;
      region.cliques.members.push_back(local_[At(v)]);
      if (f.second >= 0) region.cliques.members.push_back(local_[At(f.second)]);
      close(slot, -1);
    }
  }
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

// The pending fronts take the place of the affected ones. All memory was reserved before.
template <int B>
void BlockCholesky<B>::Replace(const std::vector<int>& affected, std::vector<Front>& pending,
                               std::vector<int>& id_of) noexcept {
  const auto gone = [&](int f) { return is_affected_[At(f)] != 0; };
  roots_.erase(std::remove_if(roots_.begin(), roots_.end(), gone), roots_.end());
  for (const int f : affected) {
    fronts_[At(f)] = Front();
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
    front.parent = front.parent >= 0 ? id_of[At(front.parent)] : -1;
    if (front.parent < 0) roots_.push_back(id_of[k]);
    for (const int v : front.pivots) front_of_[At(v)] = id_of[k];
    for (int& child : front.children) {
      if (child < 0) child = id_of[At(-1 - child)];
      fronts_[At(child)].parent = id_of[k];
    }
  }
}

template <int B>
void BlockCholesky<B>::CheckChanges(const Changes& changes) const {
  const int variables = Variables() + changes.new_variables;
  for (const auto& f : changes.added) {
    if (f.first < 0 || f.first >= variables || f.second >= variables || f.first == f.second) {
      throw std::invalid_argument("a factor names an unknown variable, or the same one twice");
    }
  }
  std::set<int> touched;
  const auto check_slot = [&](int slot) {
    if (slot < 0 || At(slot) >= factors_.size() || factors_[At(slot)].first < 0) {
      throw std::invalid_argument("no such factor slot");
    }
    if (!touched.insert(slot).second) throw std::invalid_argument("a factor slot is changed twice");
  };
  for (const int slot : changes.removed) check_slot(slot);
  for (const auto& [slot, factor] : changes.replaced) {
    check_slot(slot);
    const LinearFactor<B>& old = factors_[At(slot)];
    if (old.first != factor.first || old.second != factor.second) {
      throw std::invalid_argument("a factor may not change its variables");
    }
  }
}

// Returns the variable at which the new fronts turn out not to be positive definite, or -1.
template <int B>
int BlockCholesky<B>::FactorPending(std::vector<Front>& pending, UpdateReport& report) {
  for (Front& front : pending) {
    const int failed = FactorFront(front, pending, {});
    if (failed >= 0) return failed;
    for (int c = 0; c < front.Columns(); ++c) report.flops += std::pow(front.Rows() - c, 2);
  }
  return -1;
}

template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(Changes changes) {
  CheckChanges(changes);
  UpdateReport report;
  Undo undo;
  Region region;
  undo.variables = Variables();
  const int old_variables = Variables();
  const auto forget = [&] {
    for (const int f : region.fronts) is_affected_[At(f)] = 0;
    for (const int v : region.variables) local_[At(v)] = -1;
  };
  const auto take_back = [&] {
    forget();
    RevertFactors(undo);
    report.added_slots.clear();
  };
  std::vector<Front> pending;
  std::vector<int> id_of;
  try {
    AffectedFronts(changes, region.fronts);
    ApplyFactors(changes, report.added_slots, undo);
    {
      internal::ScopedTimer timer(report.seconds_order);
      CollectCliques(old_variables, region);
      region.order_last.assign(region.variables.size(), 0);
      for (const auto& f : changes.added) {
        // Where everything is new, nothing is newest.
        if (region.fronts.empty()) break;
        region.order_last[At(local_[At(f.first)])] = 1;
        if (f.second >= 0) region.order_last[At(local_[At(f.second)])] = 1;
      }
      pending = MakeFronts(region);
    }
    report.failed_variable = FactorPending(pending, report);
    id_of.resize(pending.size());
    Reserve(roots_, pending.size());
    Reserve(free_fronts_, region.fronts.size());
    Reserve(fronts_, pending.size());
  } catch (...) {
    take_back();
    throw;
  }
  if (report.failed_variable >= 0) {
    take_back();
    return report;
  }
  report.fronts = static_cast<int>(pending.size());
  report.variables = static_cast<int>(region.variables.size());
  Replace(region.fronts, pending, id_of);
  forget();
  free_slots_.insert(free_slots_.end(), changes.removed.begin(), changes.removed.end());
  report.path = FactorPath::kRefactored;
  report.ok = true;
  version_ = internal::NextVersion();
  return report;
}

#define TERSE_INSTANTIATE(B)                                                                                \
  template void BlockCholesky<B>::CheckChanges(const Changes&) const;                                       \
  template void BlockCholesky<B>::AffectedFronts(const Changes&, std::vector<int>&);                        \
  template int BlockCholesky<B>::FactorPending(std::vector<Front>&, UpdateReport&);                         \
  template void BlockCholesky<B>::ApplyFactors(Changes&, std::vector<int>&, Undo&);                         \
  template void BlockCholesky<B>::RevertFactors(const Undo&);                                               \
  template void BlockCholesky<B>::Attach(int);                                                              \
  template void BlockCholesky<B>::Detach(int);                                                              \
  template void BlockCholesky<B>::CollectCliques(int, Region&);                                             \
  template std::vector<BlockCholesky<B>::Front> BlockCholesky<B>::MakeFronts(const Region&) const;          \
  template void BlockCholesky<B>::Replace(const std::vector<int>&, std::vector<Front>&, std::vector<int>&); \
  template BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(Changes);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
