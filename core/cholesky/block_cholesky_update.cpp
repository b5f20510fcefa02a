// Changing the graph, and taking it back if it fails.

#include <algorithm>
#include <cmath>
#include <set>
#include <stdexcept>

#include "cholesky/block_cholesky_parts.h"
#include "support/version.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// So many changed slots and updates are remembered.
constexpr size_t kMostRemembered = 256, kMostSteps = 32;
// From so many on, removed slots leave a variable's list together.
constexpr size_t kFewDetached = 16;

// Where many of these slots go from a variable's list, they go in one pass: taking all factors of a hub out costs no
// more than their number.
template <int B>
void DetachMany(const std::vector<int>& slots, const std::vector<LinearFactor<B>>& factors,
                std::vector<std::vector<int>>& slots_of) {
  std::vector<int> sorted(slots), variables;
  std::sort(sorted.begin(), sorted.end());
  for (const int slot : slots) {
    for (const int v : {factors[At(slot)].first, factors[At(slot)].second}) {
      if (v >= 0) variables.push_back(v);
    }
  }
  std::sort(variables.begin(), variables.end());
  for (size_t k = 0; k < variables.size();) {
    const size_t begin = k;
    while (k < variables.size() && variables[k] == variables[begin]) ++k;
    if (k - begin < kFewDetached) continue;
    std::vector<int>& list = slots_of[At(variables[begin])];
    const auto is_removed = [&](int slot) { return std::binary_search(sorted.begin(), sorted.end(), slot); };
    list.erase(std::remove_if(list.begin(), list.end(), is_removed), list.end());
  }
}

}  // namespace

template <int B>
void BlockCholesky<B>::Attach(int slot) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v >= 0) AttachTo(v, slot);
  }
}

// Returns whether the slot is the last of the variable's.
template <int B>
bool BlockCholesky<B>::AttachTo(int variable, int slot) {
  auto& list = slots_of_[At(variable)];
  const bool is_last = list.empty() || list.back() < slot;
  list.insert(is_last ? list.end() : std::lower_bound(list.begin(), list.end(), slot), slot);
  return is_last;
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

// Keeps what the factor adds to H and b, which every refactorisation of its front needs.
template <int B>
void BlockCholesky<B>::SetSlot(int slot, const LinearFactor<B>& factor) {
  factors_[At(slot)] = factor;
  Normal& n = normals_[At(slot)];
  n.H_first.noalias() = factor.A_first.transpose() * factor.A_first;
  n.b_first.noalias() = -(factor.A_first.transpose() * factor.residual);
  if (factor.second < 0) return;
  n.H_second.noalias() = factor.A_second.transpose() * factor.A_second;
  n.H_cross.noalias() = factor.A_second.transpose() * factor.A_first;
  n.b_second.noalias() = -(factor.A_second.transpose() * factor.residual);
}

// What a factor adds to the diagonal of one of its variables.
template <int B>
Vector<B> BlockCholesky<B>::DiagonalPart(int variable, int slot) const {
  const Normal& n = normals_[At(slot)];
  return (factors_[At(slot)].first == variable ? n.H_first : n.H_second).diagonal();
}

// From its factors in the order of their slots, so that nothing is left of what has gone. Of a hub, block by block.
template <int B>
void BlockCholesky<B>::RecountDiagonal(int variable) {
  const auto& slots = slots_of_[At(variable)];
  const auto hub = hubs_.find(variable);
  if (hub == hubs_.end() && slots.size() <= kHub) {
    Vector<B>& sum = diagonal_[At(variable)];
    sum.setZero();
    for (const int slot : slots) sum += DiagonalPart(variable, slot);
    return;
  }
  std::map<int, Vector<B>>& blocks = hub == hubs_.end() ? hubs_[variable] : hub->second;
  for (auto& block : blocks) block.second.setZero();
  for (const int slot : slots) {
    const auto it = blocks.try_emplace(slot / kSlotBlock, Vector<B>::Zero()).first;
    it->second += DiagonalPart(variable, slot);
  }
  SumDiagonal(variable);
}

// A hub's diagonal from its blocks; of what is a hub no more from the slots, as of any other variable.
template <int B>
void BlockCholesky<B>::SumDiagonal(int variable) {
  const auto& slots = slots_of_[At(variable)];
  Vector<B>& sum = diagonal_[At(variable)];
  sum.setZero();
  if (slots.size() <= kHub) {
    for (const int slot : slots) sum += DiagonalPart(variable, slot);
  } else {
    for (const auto& block : hubs_.at(variable)) sum += block.second;
  }
}

// Of the variables (the first of a pair) with slots in these blocks that have changed. A variable costs the number of
// its factors up to kHub, a hub no more than a block and the number of its blocks.
template <int B>
void BlockCholesky<B>::RecountDiagonals(std::vector<std::pair<int, int>>& changed) {
  std::sort(changed.begin(), changed.end());
  changed.erase(std::unique(changed.begin(), changed.end()), changed.end());
  for (size_t k = 0; k < changed.size();) {
    const int v = changed[k].first;
    const auto hub = hubs_.find(v);
    if (hub == hubs_.end()) RecountDiagonal(v);
    for (; k < changed.size() && changed[k].first == v; ++k) {
      if (hub == hubs_.end()) continue;
      const int block = changed[k].second;
      const auto& slots = slots_of_[At(v)];
      auto it = std::lower_bound(slots.begin(), slots.end(), block * kSlotBlock);
      Vector<B> sum = Vector<B>::Zero();
      for (; it != slots.end() && *it / kSlotBlock == block; ++it) sum += DiagonalPart(v, *it);
      const auto known = hub->second.find(block);
      if (known != hub->second.end()) {
        known->second = sum;
      } else if (!sum.isZero(0)) {
        hub->second.emplace(block, sum);
      }
    }
    if (hub != hubs_.end()) SumDiagonal(v);
  }
}

// Attaches a new factor and adds it to the diagonal. The sum is taken in the order of the slots: one behind all others
// can be added to what is there; after any other the variable has to be counted again.
template <int B>
void BlockCholesky<B>::AttachNew(int slot, Undo& undo) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v < 0) continue;
    if (AttachTo(v, slot) && slots_of_[At(v)].size() <= kHub && hubs_.count(v) == 0) {
      if (v < undo.variables) undo.diagonals.emplace_back(v, diagonal_[At(v)]);
      diagonal_[At(v)] += DiagonalPart(v, slot);
    } else {
      undo.Recount(v, slot / kSlotBlock);
    }
  }
}

// Leaves `undo` able to take back what was done so far, whatever throws.
template <int B>
void BlockCholesky<B>::ApplyFactors(const Changes& changes, std::vector<int>& added_slots, Undo& undo) {
  undo.variables = Variables();
  undo.added.reserve(changes.added.size());
  undo.replaced.reserve(changes.replaced.size());
  undo.removed.reserve(changes.removed.size());
  added_slots.reserve(changes.added.size());
  // Neither committing nor taking back allocates.
  internal::ReserveMore(free_slots_, changes.added.size() + changes.removed.size());
  const size_t total = front_of_.size() + At(changes.new_variables);
  slots_of_.resize(total);
  row_of_.resize(total, -1);
  diagonal_.resize(total, Vector<B>::Zero());
  solution_.resize(total * B, 0.0);
  front_of_.resize(total, -1);
  const auto recount = [&](int slot) {
    for (const int v : {factors_[At(slot)].first, factors_[At(slot)].second}) {
      if (v >= 0) undo.Recount(v, slot / kSlotBlock);
    }
  };
  for (const int slot : changes.removed) {
    recount(slot);
  }
  DetachMany<B>(changes.removed, factors_, slots_of_);
  for (const int slot : changes.removed) {
    undo.removed.emplace_back(slot, factors_[At(slot)]);
    Detach(slot);
    factors_[At(slot)].first = -1;
  }
  for (const auto& [slot, factor] : changes.replaced) {
    recount(slot);
    undo.replaced.emplace_back(slot, factors_[At(slot)]);
    SetSlot(slot, factor);
  }
  for (const LinearFactor<B>& factor : changes.added) {
    int slot = static_cast<int>(factors_.size());
    if (free_slots_.empty()) {
      factors_.emplace_back();
      normals_.resize(factors_.size());
    } else {
      slot = free_slots_.back();
      free_slots_.pop_back();
    }
    SetSlot(slot, factor);
    undo.added.push_back(slot);
    added_slots.push_back(slot);
    AttachNew(slot, undo);
  }
  RecountDiagonals(undo.recounted);
}

template <int B>
void BlockCholesky<B>::RevertFactors(Undo& undo) {
  for (auto it = undo.added.rbegin(); it != undo.added.rend(); ++it) Detach(*it);
  for (const auto& [slot, factor] : undo.replaced) SetSlot(slot, factor);
  for (const auto& [slot, factor] : undo.removed) {
    SetSlot(slot, factor);
    Attach(slot);  // into lists that had room for it
  }
  RecountDiagonals(undo.recounted);  // no hub and no block comes up that is not there by now
  for (auto it = undo.diagonals.rbegin(); it != undo.diagonals.rend(); ++it) diagonal_[At(it->first)] = it->second;
  for (auto it = undo.added.rbegin(); it != undo.added.rend(); ++it) {
    factors_[At(*it)].first = -1;
    free_slots_.push_back(*it);
  }
  const size_t total = At(undo.variables);
  hubs_.erase(hubs_.lower_bound(undo.variables), hubs_.end());
  front_of_.resize(total);
  slots_of_.resize(total);
  row_of_.resize(total);
  diagonal_.resize(total);
  solution_.resize(total * B);
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

template <int B>
typename BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(const Changes& changes) {
  CheckChanges(changes);
  UpdateReport report;
  next_version_ = internal::NextVersion();
  Undo undo;
  Region region;
  const int old_variables = undo.variables = Variables();
  const auto take_back = [&] {
    Forget(region);
    RevertFactors(undo);
    report.added_slots.clear();
  };
  try {
    ApplyFactors(changes, report.added_slots, undo);
    RankPath path;
    if (HasDrifted(old_variables, region)) {
      AllFronts(region.fronts);
      report.failed_variable = RefactorRegion(old_variables, undo, region, report);
    } else if (PlanAppend(changes, old_variables, undo.added)) {
      report.failed_variable = Append(old_variables, report);
    } else {
      AffectedFronts(undo, region.fronts);
      report.failed_variable = PlanRankUpdate(changes, old_variables, region.fronts, undo.added, path)
                                   ? RankUpdate(path, old_variables, report)
                                   : RefactorRegion(old_variables, undo, region, report);
    }
  } catch (...) {
    take_back();
    throw;
  }
  if (report.failed_variable >= 0) {
    take_back();
    return report;
  }
  Forget(region);
  if (report.fronts == 0 && report.fronts_updated == 0) report.path = FactorPath::kNone;
  free_slots_.insert(free_slots_.end(), changes.removed.begin(), changes.removed.end());
  report.ok = true;
  if (report.path == FactorPath::kNone) return report;
  Remember(undo);
  version_ = next_version_;
  return report;
}

// For ChangesSince. Where memory is short, nothing is remembered.
template <int B>
void BlockCholesky<B>::Remember(const Undo& undo) noexcept try {
  Step step{version_, {}};
  for (const int slot : undo.added) step.changes.push_back({slot, LinearFactor<B>()});
  for (const auto& [slot, factor] : undo.replaced) step.changes.push_back({slot, factor});
  for (const auto& [slot, factor] : undo.removed) step.changes.push_back({slot, factor});
  size_t known = step.changes.size();
  for (const Step& s : history_) known += s.changes.size();
  history_.push_back(std::move(step));
  for (; !history_.empty() && (known > kMostRemembered || history_.size() > kMostSteps); history_.pop_front()) {
    known -= history_.front().changes.size();
  }
} catch (...) {
  history_.clear();
}

template <int B>
std::optional<std::vector<typename BlockCholesky<B>::SlotChange>> BlockCholesky<B>::ChangesSince(
    std::uint64_t version) const {
  std::vector<SlotChange> out;
  if (version == version_) return out;
  auto it = std::find_if(history_.begin(), history_.end(), [&](const Step& s) { return s.version_before == version; });
  if (it == history_.end()) return std::nullopt;
  std::set<int> seen;
  for (; it != history_.end(); ++it) {
    for (const SlotChange& change : it->changes) {
      if (seen.insert(change.slot).second) out.push_back(change);
    }
  }
  return out;
}

#define TERSE_INSTANTIATE(B)                                                                                      \
  template void BlockCholesky<B>::CheckChanges(const Changes&) const;                                             \
  template void BlockCholesky<B>::SetSlot(int, const LinearFactor<B>&);                                           \
  template Vector<B> BlockCholesky<B>::DiagonalPart(int, int) const;                                              \
  template void BlockCholesky<B>::RecountDiagonal(int);                                                           \
  template void BlockCholesky<B>::SumDiagonal(int);                                                               \
  template void BlockCholesky<B>::RecountDiagonals(std::vector<std::pair<int, int>>&);                            \
  template void BlockCholesky<B>::AttachNew(int, Undo&);                                                          \
  template void BlockCholesky<B>::ApplyFactors(const Changes&, std::vector<int>&, Undo&);                         \
  template void BlockCholesky<B>::RevertFactors(Undo&);                                                           \
  template void BlockCholesky<B>::Attach(int);                                                                    \
  template bool BlockCholesky<B>::AttachTo(int, int);                                                             \
  template void BlockCholesky<B>::Detach(int);                                                                    \
  template void BlockCholesky<B>::Remember(const Undo&) noexcept;                                                 \
  template std::optional<std::vector<BlockCholesky<B>::SlotChange>> BlockCholesky<B>::ChangesSince(std::uint64_t) \
      const;                                                                                                      \
  template BlockCholesky<B>::UpdateReport BlockCholesky<B>::Update(const Changes&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
