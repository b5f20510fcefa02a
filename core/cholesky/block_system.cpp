#include "terse/core/block_system.h"

#include <algorithm>
#include <set>
#include <stdexcept>

#include "cholesky/undo.h"
#include "terse/core/dense_kernels.h"
#include "terse/core/front.h"
#include "terse/core/graph_members.h"
#include "terse/core/parallel.h"

namespace terse {
namespace {

using internal::At;
using std::size_t;

// So many changed slots and updates are remembered.
constexpr size_t kMostRemembered = 256, kMostSteps = 32;
// From so many on, removed slots leave a variable's list together.
constexpr size_t kFewDetached = 16;
constexpr size_t kChunk = 256;  // linear factors or variables that a thread takes at a time

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
void BlockSystem<B>::Attach(int slot) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v >= 0) AttachTo(v, slot);
  }
}

// Returns whether the slot is the last of the variable's.
template <int B>
bool BlockSystem<B>::AttachTo(int variable, int slot) {
  auto& list = slots_of_[At(variable)];
  const bool is_last = list.empty() || list.back() < slot;
  list.insert(is_last ? list.end() : std::lower_bound(list.begin(), list.end(), slot), slot);
  return is_last;
}

template <int B>
void BlockSystem<B>::Detach(int slot) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v < 0) continue;
    auto& list = slots_of_[At(v)];
    const auto it = std::lower_bound(list.begin(), list.end(), slot);
    if (it != list.end() && *it == slot) list.erase(it);
  }
}

template <int B>
void BlockSystem<B>::SetNormal(const LinearFactor<B>& f, Normal& n) {
  internal::Kernels().normal_blocks(f.A_first.data(), f.second < 0 ? nullptr : f.A_second.data(), f.residual.data(), B,
                                    n.H_first.data(), n.H_second.data(), n.H_cross.data(), n.b_first.data(),
                                    n.b_second.data());
}

template <int B>
typename BlockSystem<B>::Normal BlockSystem<B>::NormalOf(const LinearFactor<B>& factor) {
  Normal n;
  SetNormal(factor, n);
  return n;
}

// Keeps what the factor adds to H and b, which every refactorisation of its front needs.
template <int B>
void BlockSystem<B>::SetSlot(int slot, const LinearFactor<B>& factor) {
  factors_[At(slot)] = factor;
  if (has_normals_) SetNormal(factor, normals_[At(slot)]);
}

// The same, and `factor` is what was there.
template <int B>
void BlockSystem<B>::ExchangeSlot(int slot, LinearFactor<B>& factor) {
  std::swap(factors_[At(slot)], factor);
  if (has_normals_) SetNormal(factors_[At(slot)], normals_[At(slot)]);
}

template <int B>
void BlockSystem<B>::DropNormals() {
  has_normals_ = false;
  normals_ = {};
}

// What a factor adds to the diagonal of one of its variables.
template <int B>
Vector<B> BlockSystem<B>::DiagonalPart(int variable, int slot) const {
  const bool is_first = factors_[At(slot)].first == variable;
  if (has_normals_) return (is_first ? normals_[At(slot)].H_first : normals_[At(slot)].H_second).diagonal();
  return (is_first ? factors_[At(slot)].A_first : factors_[At(slot)].A_second).colwise().squaredNorm();
}

// From its factors in the order of their slots, so that nothing is left of what has gone. Of a hub, block by block.
template <int B>
void BlockSystem<B>::RecountDiagonal(int variable) {
  const auto& slots = slots_of_[At(variable)];
  const auto hub = hub_sums_.find(variable);
  if (hub == hub_sums_.end() && slots.size() <= kHub) {
    Vector<B>& sum = diagonal_[At(variable)];
    sum.setZero();
    for (const int slot : slots) sum += DiagonalPart(variable, slot);
    return;
  }
  std::map<int, Vector<B>>& blocks = hub == hub_sums_.end() ? hub_sums_[variable] : hub->second;
  for (auto& block : blocks) block.second.setZero();
  for (const int slot : slots) {
    const auto it = blocks.try_emplace(slot / kSlotBlock, Vector<B>::Zero()).first;
    it->second += DiagonalPart(variable, slot);
  }
  SumDiagonal(variable);
}

// A hub's diagonal from its blocks; of what is a hub no more from the slots, as of any other variable.
template <int B>
void BlockSystem<B>::SumDiagonal(int variable) {
  const auto& slots = slots_of_[At(variable)];
  Vector<B>& sum = diagonal_[At(variable)];
  sum.setZero();
  if (slots.size() <= kHub) {
    for (const int slot : slots) sum += DiagonalPart(variable, slot);
  } else {
    for (const auto& block : hub_sums_.at(variable)) sum += block.second;
  }
}

// Of the variables (the first of a pair) with slots in these blocks that have changed. A variable costs the number of
// its factors up to kHub, a hub no more than a block and the number of its blocks.
template <int B>
void BlockSystem<B>::RecountDiagonals(std::vector<std::pair<int, int>>& changed) {
  std::sort(changed.begin(), changed.end());
  changed.erase(std::unique(changed.begin(), changed.end()), changed.end());
  for (size_t k = 0; k < changed.size();) {
    const int v = changed[k].first;
    const auto hub = hub_sums_.find(v);
    if (hub == hub_sums_.end()) RecountDiagonal(v);
    for (; k < changed.size() && changed[k].first == v; ++k) {
      if (hub == hub_sums_.end()) continue;
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
    if (hub != hub_sums_.end()) SumDiagonal(v);
  }
}

// Attaches a new factor and adds it to the diagonal. The sum is taken in the order of the slots: one behind all others
// can be added to what is there; after any other the variable has to be counted again.
template <int B>
void BlockSystem<B>::AttachNew(int slot, Undo& undo) {
  const LinearFactor<B>& f = factors_[At(slot)];
  for (const int v : {f.first, f.second}) {
    if (v < 0) continue;
    if (AttachTo(v, slot) && slots_of_[At(v)].size() <= kHub && hub_sums_.count(v) == 0) {
      if (v < undo.variables) undo.diagonals.emplace_back(v, diagonal_[At(v)]);
      diagonal_[At(v)] += DiagonalPart(v, slot);
    } else {
      undo.Recount(v, slot / kSlotBlock);
    }
  }
}

template <int B>
void BlockSystem<B>::Apply(const Changes& changes, Replaced replaced, Undo& undo) {
  undo.variables = Variables();
  undo.added.reserve(changes.added.size());
  undo.removed.reserve(changes.removed.size());
  // Neither committing nor taking back allocates.
  internal::ReserveMore(free_slots_, changes.added.size() + changes.removed.size());
  internal::ReserveMore(factors_, changes.added.size());
  if (has_normals_) internal::ReserveMore(normals_, changes.added.size());
  const size_t total = slots_of_.size() + At(changes.new_variables);
  slots_of_.resize(total);
  diagonal_.resize(total, Vector<B>::Zero());
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
  for (const auto& change : replaced) recount(change.first);
  undo.replaced = std::move(replaced);
  for (auto& [slot, factor] : undo.replaced) ExchangeSlot(slot, factor);
  for (const LinearFactor<B>& factor : changes.added) {
    int slot = static_cast<int>(factors_.size());
    if (free_slots_.empty()) {
      factors_.emplace_back();
      if (has_normals_) normals_.resize(factors_.size());
    } else {
      slot = free_slots_.back();
      free_slots_.pop_back();
    }
    SetSlot(slot, factor);
    undo.added.push_back(slot);
    AttachNew(slot, undo);
  }
  RecountDiagonals(undo.recounted);
}

template <int B>
void BlockSystem<B>::Revert(Undo& undo) {
  for (auto it = undo.added.rbegin(); it != undo.added.rend(); ++it) Detach(*it);
  for (auto& [slot, factor] : undo.replaced) ExchangeSlot(slot, factor);
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
  hub_sums_.erase(hub_sums_.lower_bound(undo.variables), hub_sums_.end());
  slots_of_.resize(total);
  diagonal_.resize(total);
}

template <int B>
void BlockSystem<B>::Check(const Changes& changes) const {
  const int variables = Variables() + changes.new_variables;
  for (const auto& f : changes.added) {
    if (f.first < 0 || f.first >= variables || f.second >= variables || f.first == f.second) {
      throw std::invalid_argument("a factor names an unknown variable, or the same one twice");
    }
  }
  std::vector<int> touched;
  touched.reserve(changes.removed.size() + changes.replaced.size());
  const auto check_slot = [&](int slot) {
    if (slot < 0 || At(slot) >= factors_.size() || factors_[At(slot)].first < 0) {
      throw std::invalid_argument("no such factor slot");
    }
    touched.push_back(slot);
  };
  for (const int slot : changes.removed) check_slot(slot);
  for (const auto& [slot, factor] : changes.replaced) {
    check_slot(slot);
    const LinearFactor<B>& old = factors_[At(slot)];
    if (old.first != factor.first || old.second != factor.second) {
      throw std::invalid_argument("a factor may not change its variables");
    }
  }
  if (!std::is_sorted(touched.begin(), touched.end())) std::sort(touched.begin(), touched.end());
  if (std::adjacent_find(touched.begin(), touched.end()) != touched.end()) {
    throw std::invalid_argument("a factor slot is changed twice");
  }
}

template <int B>
std::vector<double> BlockSystem<B>::Gradient() const {
  std::vector<double> b(slots_of_.size() * B, 0.0);
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
std::vector<double> BlockSystem<B>::Diagonal() const {
  std::vector<double> d;
  d.reserve(diagonal_.size() * B);
  for (const Vector<B>& v : diagonal_) d.insert(d.end(), v.data(), v.data() + B);
  return d;
}

template <int B>
void BlockSystem<B>::RequireSameVariables(const std::vector<LinearFactor<B>>& factors) const {
  if (factors.size() > factors_.size()) throw std::invalid_argument("no such factor slot");
  for (size_t k = 0; k < factors.size(); ++k) {
    if (factors_[k].first != factors[k].first || factors_[k].second != factors[k].second) {
      throw std::invalid_argument("a factor may not change its variables");
    }
  }
}

template <int B>
void BlockSystem<B>::SetLinearFactors(const std::vector<LinearFactor<B>>& factors, int threads) {
  RequireSameVariables(factors);
  std::copy(factors.begin(), factors.end(), factors_.begin());
  RenewNormals(factors.size(), threads);
}

template <int B>
void BlockSystem<B>::ExchangeLinearFactors(std::vector<LinearFactor<B>>& factors, int threads) {
  if (factors.size() != factors_.size()) throw std::invalid_argument("one linear factor per slot is needed");
  RequireSameVariables(factors);
  factors_.swap(factors);
  RenewNormals(factors_.size(), threads);
}

// Of the first `slots`, after their linear factors.
template <int B>
void BlockSystem<B>::RenewNormals(size_t slots, int threads) {
  internal::SpreadChunks(threads, has_normals_ ? slots : 0, kChunk, [&](size_t begin, size_t end) {
    for (size_t k = begin; k < end; ++k) SetNormal(factors_[k], normals_[k]);
  });
  internal::SpreadChunks(threads, slots_of_.size(), kChunk, [&](size_t begin, size_t end) {
    for (size_t v = begin; v < end; ++v) {
      if (hub_sums_.count(static_cast<int>(v)) == 0) RecountDiagonal(static_cast<int>(v));
    }
  });
  for (const auto& hub : hub_sums_) RecountDiagonal(hub.first);
}

// Where memory is short, nothing is remembered.
template <int B>
void BlockSystem<B>::Commit(const Undo& undo, std::uint64_t version_before) noexcept {
  for (const auto& change : undo.removed) free_slots_.push_back(change.first);  // Apply made room
  const size_t changed = undo.added.size() + undo.replaced.size() + undo.removed.size();
  if (changed > kMostRemembered) return history_.clear();
  try {
    Step step{version_before, {}};
    step.changes.reserve(changed);
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
}

template <int B>
std::optional<std::vector<typename BlockSystem<B>::SlotChange>> BlockSystem<B>::ChangesSince(
    std::uint64_t version, std::uint64_t present) const {
  std::vector<SlotChange> out;
  if (version == present) return out;
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

// Nobody can ask yet what changed since a version of before: the history is not stored.
template <int B>
template <class Archive>
void BlockSystem<B>::Serialize(Archive& archive) {
  auto& [factors, normals, has_normals, free_slots, slots_of, diagonal, hub_sums, history] = *this;
  archive(factors, free_slots);
}

template <int B>
void BlockSystem<B>::Rebuild(size_t variables) {
  has_normals_ = true;
  normals_.assign(factors_.size(), Normal());
  slots_of_.assign(variables, {});
  diagonal_.assign(variables, Vector<B>::Zero());
  hub_sums_.clear();
  history_.clear();
  for (int slot = 0; slot < Slots(); ++slot) {
    if (factors_[At(slot)].first < 0) continue;
    SetSlot(slot, factors_[At(slot)]);
    Attach(slot);
  }
  for (int v = 0; v < Variables(); ++v) RecountDiagonal(v);
}

template <int B>
std::string BlockSystem<B>::FindDefect(size_t variables) const {
  const int n = static_cast<int>(variables);
  size_t living = 0;
  for (const LinearFactor<B>& f : factors_) {
    if (f.first < -1 || f.first >= n || f.second < -1 || f.second >= n || (f.first >= 0 && f.first == f.second)) {
      return "a linear factor names a variable that there is not";
    }
    living += f.first >= 0 ? 1 : 0;
  }
  std::vector<char> is_taken(factors_.size(), 0);
  for (const int slot : free_slots_) {
    if (slot < 0 || slot >= Slots()) return "a free slot that there is not";
    if (std::exchange(is_taken[At(slot)], 1) != 0 || factors_[At(slot)].first >= 0) return "a free slot is in use";
  }
  return living + free_slots_.size() == factors_.size() ? "" : "a slot is neither free nor in use";
}

template void BlockSystem<3>::Serialize(StateWriter&);
template void BlockSystem<3>::Serialize(StateReader&);
template void BlockSystem<6>::Serialize(StateWriter&);
template void BlockSystem<6>::Serialize(StateReader&);
template class BlockSystem<3>;
template class BlockSystem<6>;

}  // namespace terse
