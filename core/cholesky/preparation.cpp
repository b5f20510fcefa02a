#include "cholesky/preparation.h"

#include <algorithm>
#include <utility>

#include "terse/core/graph_members.h"

namespace terse::internal {
namespace {

// How fast the measured speed follows.
constexpr double kFollow = 0.3;

}  // namespace

template <int B>
void Preparation<B>::Invalidate(const LinearFactor<B>& factor) {
  changed_.push_back(factor.first);
  if (factor.second >= 0) changed_.push_back(factor.second);
}

template <int B>
void Preparation<B>::Replace(const Replaced& replaced, const BlockSystem<B>& system, std::uint64_t version) {
  ForgetChanged(system, version);
  entry_of_.resize(At(system.Slots()), -1);
  is_listed_.resize(At(system.Variables()), 0);
  for (const auto& [slot, factor] : replaced) {
    int& entry = entry_of_[At(slot)];
    if (entry < 0) {
      entry = static_cast<int>(entries_.size());
      entries_.emplace_back(slot, factor);
    } else {
      entries_[At(entry)].second = factor;
    }
    Invalidate(factor);
    for (const int v : {factor.first, factor.second}) {
      if (v >= 0 && std::exchange(is_listed_[At(v)], 1) == 0) variables_.push_back(v);
    }
  }
}

template <int B>
void Preparation<B>::ForgetChanged(const BlockSystem<B>& system, std::uint64_t version) {
  if (entries_.empty()) seen_ = step_ended_ = version;
  const auto changes = system.ChangesSince(std::exchange(seen_, version), version);
  if (!changes) {
    Forget();
    seen_ = step_ended_ = version;
    return;
  }
  for (const auto& change : *changes) {
    if (!Has(change.slot)) continue;
    Invalidate(entries_[At(entry_of_[At(change.slot)])].second);
    entry_of_[At(change.slot)] = -1;
  }
}

template <int B>
typename Preparation<B>::Replaced Preparation<B>::Take(const BlockSystem<B>& system, std::uint64_t version) {
  ForgetChanged(system, version);
  Replaced out;
  out.reserve(entries_.size());
  for (std::size_t slot = 0; slot < entry_of_.size(); ++slot) {
    if (entry_of_[slot] >= 0) out.push_back(entries_[At(entry_of_[slot])]);
  }
  return out;
}

template <int B>
bool Preparation<B>::IsReady(int front, const FrontTree<B>& tree) const {
  return At(front) < place_.size() && place_[At(front)] >= 0 && stamps_[At(place_[At(front)])] == tree[front].stamp;
}

// Factors a front of the tree ahead; children before parents.
template <int B>
int Preparation<B>::Factor(int id, const FrontPaths<B>& affected, const BlockSystem<B>& system, FrontTree<B>& tree,
                           FrontFactorization<B>& numbers) {
  Front<B>& front = fronts_[At(place_[At(id)])];
  const auto place = [&](int child) { return affected.Find(child) < 0 ? -1 : place_[At(child)]; };
  numbers.CopyShape(id, place, tree, front);
  const std::size_t rows = At(front.Rows()), p = At(front.Columns()), n = rows - p;
  if (front.panel.Size() < rows * p) front.panel.SetBuffer(FrontBuffer(rows * p));
  if (front.update.size() < n * n) front.update = FrontBuffer(n * n);
  typename FrontFactorization<B>::Normals normals;
  for (const int slot : front.slots) {
    if (Has(slot)) normals[slot] = BlockSystem<B>::NormalOf(entries_[At(entry_of_[At(slot)])].second);
  }
  return numbers.Factor(front, fronts_, system, tree, {}, &normals);
}

template <int B>
PreparationProgress Preparation<B>::Advance(Clock::time_point deadline, const BlockSystem<B>& system,
                                            std::uint64_t version, FrontTree<B>& tree, FrontFactorization<B>& numbers) {
  ForgetChanged(system, version);
  place_.resize(At(tree.Size()), -1);
  {
    FrontPaths<B> changed(tree);
    for (const int v : std::exchange(changed_, {})) changed.Add(v);
    for (int k = 0; k < changed.Size(); ++k) {
      const int place = place_[At(changed.IdAt(k))];
      if (place >= 0) stamps_[At(place)] = 0;
    }
  }
  FrontPaths<B> affected(tree);
  for (const int v : variables_) affected.Add(v);
  const auto is_hot = [&](int id) { return tree[id].stamp > step_ended_; };
  double flops_left = 0;
  PreparationProgress out;
  MakePlaces(affected);
  for (int k = 0; k < affected.Size(); ++k) {
    const int id = affected.IdAt(k);
    if (IsReady(id, tree)) continue;
    if (!is_hot(id)) ++out.fronts_left;
    flops_left += affected[k].RefactorFlops();
  }
  const auto start = Clock::now();
  auto now = start;
  double done = 0;
  for (int k = affected.Size() - 1; k >= 0 && out.fronts_left > 0; --k) {
    const int id = affected.IdAt(k);
    if (IsReady(id, tree) || is_hot(id)) continue;
    const double flops = affected[k].RefactorFlops();
    const std::chrono::duration<double> left = deadline - now;
    if (done > 0 && flops * seconds_per_flop_ > left.count()) break;
    out.failed_variable = Factor(id, affected, system, tree, numbers);
    if (out.failed_variable >= 0) return out;
    stamps_[At(place_[At(id)])] = tree[id].stamp;
    done += flops;
    --out.fronts_left;
    now = Clock::now();
  }
  if (done > 0) {
    seconds_per_flop_ += kFollow * (std::chrono::duration<double>(now - start).count() / done - seconds_per_flop_);
  }
  out.seconds_left = std::max(0.0, flops_left - done) * seconds_per_flop_;
  return out;
}

template <int B>
void Preparation<B>::MakePlaces(const FrontPaths<B>& affected) {
  for (int k = 0; k < affected.Size(); ++k) {
    int& place = place_[At(affected.IdAt(k))];
    if (place >= 0) continue;
    place = static_cast<int>(fronts_.size());
    fronts_.emplace_back();
    stamps_.push_back(0);
  }
}

template <int B>
std::string Preparation<B>::FindStateDefect(const std::vector<int>& slots, const std::vector<char>& is_ready,
                                            const BlockSystem<B>& system, const FrontTree<B>& tree) const {
  if (slots.size() != entries_.size() || (!is_ready.empty() && is_ready.size() != At(tree.Size()))) {
    return "what is prepared has different sizes";
  }
  for (std::size_t k = 0; k < slots.size(); ++k) {
    if (slots[k] < 0 || slots[k] >= system.Slots()) return "a slot is prepared that there is not";
    const LinearFactor<B>& now = system.LinearFactorAt(slots[k]);
    const LinearFactor<B>& then = entries_[k].second;
    if (now.first < 0 || now.first != then.first || now.second != then.second) {
      return "a slot is prepared for other variables";
    }
  }
  for (const auto* list : {&variables_, &changed_}) {
    for (const int v : *list) {
      if (v < 0 || v >= system.Variables()) return "a variable is prepared that there is not";
    }
  }
  return "";
}

template <int B>
template <class Archive>
void Preparation<B>::Serialize(Archive& archive, const BlockSystem<B>& system, std::uint64_t version,
                               FrontTree<B>& tree, FrontFactorization<B>& numbers) {
  std::vector<int> slots;
  std::vector<LinearFactor<B>> factors;
  std::vector<char> is_ready;
  if constexpr (!Archive::kReads) {
    for (std::size_t slot = 0; slot < entry_of_.size() && seen_ == version; ++slot) {
      if (entry_of_[slot] < 0) continue;
      slots.push_back(static_cast<int>(slot));
      factors.push_back(entries_[At(entry_of_[slot])].second);
    }
    for (int f = 0; f < tree.Size() && !slots.empty(); ++f) is_ready.push_back(IsReady(f, tree) ? 1 : 0);
  }
  archive(slots, factors, variables_, changed_, is_ready);
  if constexpr (Archive::kReads) {
    for (std::size_t k = 0; k < std::min(slots.size(), factors.size()); ++k)
      entries_.emplace_back(slots[k], factors[k]);
    const std::string defect =
        slots.size() == factors.size() ? FindStateDefect(slots, is_ready, system, tree) : "factors without a slot";
    if (!defect.empty()) archive.Fail(defect);
    seen_ = step_ended_ = version;
    entry_of_.assign(At(system.Slots()), -1);
    for (std::size_t k = 0; k < slots.size(); ++k) entry_of_[At(slots[k])] = static_cast<int>(k);
    is_listed_.assign(At(system.Variables()), 0);
    for (const int v : variables_) is_listed_[At(v)] = 1;
    if (is_ready.empty()) return;
    place_.assign(At(tree.Size()), -1);
    FrontPaths<B> affected(tree);
    for (const int v : variables_) affected.Add(v);
    MakePlaces(affected);
    for (int k = affected.Size() - 1; k >= 0; --k) {
      const int id = affected.IdAt(k);
      if (is_ready[At(id)] == 0) continue;
      for (const int child : tree[id].children) {
        if (affected.Find(child) >= 0 && !IsReady(child, tree)) archive.Fail("a front is ready before one below it");
      }
      if (Factor(id, affected, system, tree, numbers) >= 0) archive.Fail("what is prepared is not positive definite");
      stamps_[At(place_[At(id)])] = tree[id].stamp;
    }
  }
}

#define TERSE_INSTANTIATE(B)                                                                                 \
  template class Preparation<B>;                                                                             \
  template void Preparation<B>::Serialize(StateWriter&, const BlockSystem<B>&, std::uint64_t, FrontTree<B>&, \
                                          FrontFactorization<B>&);                                           \
  template void Preparation<B>::Serialize(StateReader&, const BlockSystem<B>&, std::uint64_t, FrontTree<B>&, \
                                          FrontFactorization<B>&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
