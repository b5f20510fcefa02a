#include "terse/core/front_tree.h"

#include <algorithm>

#include "cholesky/undo.h"
#include "terse/core/graph_members.h"

namespace terse::internal {
namespace {

using std::size_t;

// Whether all are numbers from `least` to n - 1.
bool AreBelow(const std::vector<int>& numbers, size_t n, int least = 0) {
  return std::all_of(numbers.begin(), numbers.end(), [&](int i) { return i >= least && (i < 0 || At(i) < n); });
}

// For a matrix of which the lower trapezoid comes next.
template <class Archive>
FrontBuffer RoomFor(Archive& archive, int rows, int columns) {
  archive.Require(At(rows) * At(columns) / 2, sizeof(double));
  return FrontBuffer(At(rows) * At(columns));
}

// The lower trapezoid of a column-major matrix. What is above is never read.
template <class Archive, class Number>
void SerializeLower(Archive& archive, Number* matrix, int rows, int columns) {
  for (int c = 0; c < columns; ++c) archive.Doubles(matrix + At(c) * At(rows) + At(c), At(rows - c));
}

}  // namespace

template <int B>
std::int64_t FrontTree<B>::Nonzeros() const {
  std::int64_t sum = 0;
  for (const auto& front : fronts_) {
    const std::int64_t p = front.Columns(), rows = front.pivots.empty() ? 0 : front.Rows() - 1;
    sum += p * rows - p * (p - 1) / 2;
  }
  return sum;
}

template <int B>
std::vector<int> FrontTree<B>::TopDown() const {
  std::vector<int> order(roots_);
  for (size_t k = 0; k < order.size(); ++k) {
    const auto& children = fronts_[At(order[k])].children;
    order.insert(order.end(), children.begin(), children.end());
  }
  return order;
}

template <int B>
void FrontTree<B>::Append(std::vector<Front<B>>& leaves, const std::vector<int>& parents, std::uint64_t version) {
  const size_t count = leaves.size();
  ReserveMore(fronts_, count);
  ReserveMore(waiting_, count);
  // A front gets its child when all that can fail is done.
  std::vector<int> ids;
  for (const int parent : parents) {
    ids.push_back(static_cast<int>(fronts_.size() + ids.size()));
    if (parent >= 0) ReserveMore(fronts_[At(parent)].children, count);
  }
  for (size_t k = 0; k < count; ++k) {
    if (parents[k] < 0) leaves[At(-1 - parents[k])].children.reserve(count);
  }
  for (size_t k = 0; k < count; ++k) {
    Front<B>& front = leaves[k];
    front.parent = parents[k] >= 0 ? parents[k] : ids[At(-1 - parents[k])];
    front.stamp = version;
    log_det_ += front.log_det;
    y2_ += front.y2;
    front_of_[At(front.pivots.front())] = ids[k];
    fronts_[At(front.parent)].children.push_back(ids[k]);
    waiting_.push_back(ids[k]);
    fronts_.push_back(std::move(front));
  }
}

template <int B>
void FrontTree<B>::Replace(const std::vector<int>& gone, const std::vector<char>& is_gone,
                           std::vector<Front<B>>& pending, std::uint64_t version, BufferPool& pool) {
  std::vector<int> id_of(pending.size());
  ReserveMore(roots_, pending.size());
  ReserveMore(free_fronts_, gone.size());
  ReserveMore(fronts_, pending.size());
  for (const int f : gone) {
    pool.MakeRoom(fronts_[At(f)].panel.Size());
    pool.MakeRoom(fronts_[At(f)].update.size());
  }
  // From here on nothing allocates.
  roots_.erase(std::remove_if(roots_.begin(), roots_.end(), [&](int f) { return is_gone[At(f)] != 0; }), roots_.end());
  for (const int f : gone) {
    Front<B>& front = fronts_[At(f)];
    log_det_ -= front.log_det;
    y2_ -= front.y2;
    pool.Give(front.panel.TakeBuffer());
    pool.Give(std::move(front.update));
    front = Front<B>();
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
    Front<B>& front = fronts_[At(id_of[k])] = std::move(pending[k]);
    log_det_ += front.log_det;
    y2_ += front.y2;
    front.stamp = version;
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
void FrontTree<B>::MakeRoom(int front, const Front<B>& changed) {
  ReserveMore(fronts_[At(front)].corrections, 1);
  ReserveMore(fronts_[At(front)].slots, changed.slots.size());
}

template <int B>
void FrontTree<B>::Exchange(int id, Front<B>&& changed, std::uint64_t version, BufferPool& pool) noexcept {
  Front<B>& front = fronts_[At(id)];
  log_det_ += changed.log_det - front.log_det;
  y2_ += changed.y2 - front.y2;
  front.log_det = changed.log_det;
  front.y2 = changed.y2;
  front.pivots.swap(changed.pivots);
  front.separators.swap(changed.separators);
  front.panel.Swap(changed.panel);
  pool.Give(changed.panel.TakeBuffer());
  if (front.parent >= 0) front.corrections.push_back(std::move(changed.corrections.front()));
  front.slots.insert(front.slots.end(), changed.slots.begin(), changed.slots.end());
  front.fresh = true;
  front.stamp = version;
}

template <int B>
void FrontTree<B>::ExchangeNumbers(int id, Front<B>& other, std::uint64_t version) noexcept {
  Front<B>& front = fronts_[At(id)];
  log_det_ += other.log_det - front.log_det;
  y2_ += other.y2 - front.y2;
  std::swap(front.log_det, other.log_det);
  std::swap(front.y2, other.y2);
  front.panel.Swap(other.panel);
  front.update.swap(other.update);
  std::swap(front.update_separators, other.update_separators);
  front.corrections.swap(other.corrections);
  front.fresh = true;
  front.stamp = version;
}

template <int B>
void FrontTree<B>::SetFrontOf(int first, int end, int front) noexcept {
  for (int v = first; v < end; ++v) front_of_[At(v)] = front;
}

template <int B>
void FrontTree<B>::NoteRefactored(const std::vector<int>& order, std::uint64_t version) {
  log_det_ = y2_ = 0;
  for (const int f : order) {
    Front<B>& front = fronts_[At(f)];
    front.fresh = true;
    front.stamp = version;
    log_det_ += front.log_det;
    y2_ += front.y2;
  }
}

template <int B>
template <class Archive>
void FrontTree<B>::SerializeShape(Archive& archive) {
  auto& [fronts, free_fronts, front_of, roots, waiting, log_det, y2] = *this;
  archive(front_of, free_fronts, roots, waiting, log_det, y2);
}

template <int B>
template <class Archive>
void FrontTree<B>::SerializeFronts(Archive& archive, std::uint64_t version) {
  archive.Each(fronts_, [&](Front<B>& front) { SerializeFront(archive, front, version); });
}

// Known before: front_of_, for how many variables there are. Stamps start anew with the version.
template <int B>
template <class Archive>
void FrontTree<B>::SerializeFront(Archive& archive, Front<B>& front, std::uint64_t version) const {
  auto& [parent, pivots, separators, children, slots, panel, update, update_separators, corrections, log_det, y2, fresh,
         stamp, ordered_rows, ordered_columns] = front;
  archive(parent, pivots, separators, children, slots, update_separators, log_det, y2, fresh, ordered_rows,
          ordered_columns);
  if constexpr (Archive::kReads) {
    stamp = version;
    if (pivots.size() + separators.size() > front_of_.size() || update_separators < 0 ||
        At(update_separators) > separators.size()) {
      archive.Fail("a front of the factor has impossible sizes");
    }
  }
  if (pivots.empty()) return;  // a free one
  const int rows = front.Rows(), columns = front.Columns(), n = front.UpdateRows();
  if constexpr (Archive::kReads) {
    panel.SetBuffer(RoomFor(archive, rows, columns));
    SerializeLower(archive, panel.Buffer(), rows, columns);
    update = RoomFor(archive, n, n);
  } else {
    SerializeLower(archive, panel.Numbers(), rows, columns);
  }
  SerializeLower(archive, update.data(), n, n);
  archive.Each(corrections, [&](Correction& correction) {
    auto& [count, columns, W] = correction;
    archive(count, columns, W);
    if constexpr (Archive::kReads) {
      if (count < 0 || At(count) > front.separators.size() || columns < 0 ||
          W.size() != At(B * count + 1) * At(columns)) {
        archive.Fail("a correction of the factor has impossible sizes");
      }
    }
  });
}

// Every variable is pivot of one front, every front is a root or child of one, separators are variables further up.
template <int B>
std::string FrontTree<B>::FindDefect() const {
  const size_t n = front_of_.size(), count = fronts_.size();
  if (!AreBelow(front_of_, count) || !AreBelow(roots_, count) || !AreBelow(waiting_, count) ||
      !AreBelow(free_fronts_, count)) {
    return "the parts of the factor have different sizes";
  }
  for (const Front<B>& front : fronts_) {
    if (!AreBelow(front.pivots, n) || !AreBelow(front.separators, n) || !AreBelow(front.children, count) ||
        front.parent < -1) {
      return "a front of the factor names what there is not";
    }
  }
  std::vector<char> is_reached(count, 0);
  std::vector<int> seen_in(n, -1), order;  // `order`: parents before children
  const auto reach = [&](int f, int parent) {
    if (fronts_[At(f)].parent != parent || fronts_[At(f)].pivots.empty() || is_reached[At(f)] != 0) return false;
    is_reached[At(f)] = 1;
    order.push_back(f);
    return true;
  };
  for (const int f : roots_) {
    if (!reach(f, -1)) return "the fronts of the factor are no tree";
  }
  size_t pivots = 0;
  for (size_t k = 0; k < order.size(); ++k) {
    const int f = order[k];
    const Front<B>& front = fronts_[At(f)];
    const auto take = [&](int v) { return std::exchange(seen_in[At(v)], f) != f; };
    const auto is_own = [&](int v) { return front_of_[At(v)] == f && take(v); };
    if (!std::all_of(front.pivots.begin(), front.pivots.end(), is_own)) return "a variable has two fronts";
    if (!std::all_of(front.separators.begin(), front.separators.end(), take)) return "a front has a variable twice";
    if (front.parent < 0 && (!front.separators.empty() || !front.corrections.empty())) return "a root has separators";
    pivots += front.pivots.size();
    for (const int child : front.children) {
      if (!reach(child, f)) return "the fronts of the factor are no tree";
      for (const int v : fronts_[At(child)].separators) {
        if (seen_in[At(v)] != f) return "a front lacks a variable of its child";
      }
    }
  }
  if (pivots != n) return "a variable has no front";
  for (const int f : free_fronts_) {
    if (std::exchange(is_reached[At(f)], 1) != 0) return "a free front of the factor is in use";
  }
  return order.size() + free_fronts_.size() == count ? "" : "a front of the factor belongs nowhere";
}

// In a tree that is one: every living factor is in one front, which has its variables.
template <int B>
std::string FrontTree<B>::FindSlotDefect(const BlockSystem<B>& system) const {
  long living = 0;
  for (int slot = 0; slot < system.Slots(); ++slot) living += system.LinearFactorAt(slot).first >= 0 ? 1 : 0;
  std::vector<char> is_taken(At(system.Slots()), 0);
  std::vector<int> seen_in(front_of_.size(), -1);
  for (int f = 0; f < Size(); ++f) {
    const Front<B>& front = fronts_[At(f)];
    if (front.pivots.empty() && !front.slots.empty()) return "a free front has factors";
    if (!AreBelow(front.slots, is_taken.size())) return "a front names what there is not";
    for (const int v : front.pivots) seen_in[At(v)] = f;
    for (const int v : front.separators) seen_in[At(v)] = f;
    living -= static_cast<long>(front.slots.size());
    for (const int slot : front.slots) {
      const LinearFactor<B>& factor = system.LinearFactorAt(slot);
      if (std::exchange(is_taken[At(slot)], 1) != 0 || factor.first < 0) {
        return "a linear factor is in two fronts, or in one and free";
      }
      if (seen_in[At(factor.first)] != f || (factor.second >= 0 && seen_in[At(factor.second)] != f)) {
        return "a front lacks a variable of its factor";
      }
    }
  }
  return living == 0 ? "" : "a linear factor is in no front";
}

#define TERSE_INSTANTIATE(B)                                                \
  template class FrontTree<B>;                                              \
  template void FrontTree<B>::SerializeShape(StateWriter&);                 \
  template void FrontTree<B>::SerializeShape(StateReader&);                 \
  template void FrontTree<B>::SerializeFronts(StateWriter&, std::uint64_t); \
  template void FrontTree<B>::SerializeFronts(StateReader&, std::uint64_t);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
