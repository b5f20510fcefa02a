// What of the factor is stored, and whether what was stored can be one.

#include <algorithm>
#include <limits>

#include "support/version.h"
#include "terse/core/block_cholesky.h"
#include "terse/core/state_members.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// Whether all are numbers from `least` to n - 1.
bool AreBelow(const std::vector<int>& numbers, size_t n, int least = 0) {
  return std::all_of(numbers.begin(), numbers.end(), [&](int i) { return i >= least && (i < 0 || At(i) < n); });
}

// The lower trapezoid of a column-major matrix. What is above is never read.
template <class Archive>
void SerializeLower(Archive& archive, std::vector<double>& matrix, int rows, int columns) {
  if constexpr (Archive::kReads) {
    archive.Require(At(rows) * At(columns) / 2, sizeof(double));
    matrix.assign(At(rows) * At(columns), 0.0);
  }
  for (int c = 0; c < columns; ++c) archive.Doubles(matrix.data() + At(c) * At(rows) + At(c), At(rows - c));
}

}  // namespace

// Known before: front_of_ and factors_, for how many variables and slots there are. Stamps start anew with the version.
template <int B>
template <class Archive>
void BlockCholesky<B>::SerializeFront(Archive& archive, Front& front) const {
  auto& [parent, pivots, separators, children, slots, panel, update, update_separators, corrections, log_det, y2, fresh,
         stamp, ordered_rows, ordered_columns] = front;
  archive(parent, pivots, separators, children, slots, update_separators, log_det, y2, fresh, ordered_rows,
          ordered_columns);
  if constexpr (Archive::kReads) {
    stamp = version_;
    if (pivots.size() + separators.size() > front_of_.size() || update_separators < 0 ||
        At(update_separators) > separators.size()) {
      archive.Fail("a front of the factor has impossible sizes");
    }
  }
  if (pivots.empty()) return;  // a free one
  SerializeLower(archive, panel, front.Rows(), front.Columns());
  const int n = B * update_separators + 1;
  SerializeLower(archive, update, n, n);
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

// Nobody can ask yet what changed since a version of before, nor has covariances of one: the history is not stored, the
// version is drawn anew, and the identity is that of a new object.
template <int B>
template <class Archive>
void BlockCholesky<B>::Serialize(Archive& archive) {
  auto& [factors, normals, free_slots, slots_of, fronts, free_fronts, front_of, roots, waiting, log_det, y2, solution,
         last_solve, method, threads, row_of, thread_row_of, local, is_affected, diagonal, hubs, moved, position,
         stamp_of, last_stamp, drift_looked_at, debt, pool, identity, version, next_version, history] = *this;
  archive(factors, free_slots, front_of, free_fronts, roots, waiting, log_det, y2, solution, last_solve.flops,
          last_solve.deferred, method, threads, drift_looked_at, debt);
  if constexpr (Archive::kReads) {
    if (front_of.size() > At(std::numeric_limits<int>::max() / B - 1)) archive.Fail("too many variables");
    if (threads < 1) archive.Fail("a factor without a thread");
    if (drift_looked_at < 0 || At(drift_looked_at) > front_of.size()) archive.Fail("the factor was larger once");
    version = next_version = internal::NextVersion();
  }
  archive.Each(fronts, [&](Front& front) { SerializeFront(archive, front); });
  if constexpr (Archive::kReads) {
    std::string defect = FindTreeDefect();
    if (defect.empty()) defect = FindSlotDefect();
    if (!defect.empty()) archive.Fail(defect);
    RebuildDerived();
  }
}

template <int B>
void BlockCholesky<B>::RebuildDerived() {
  const size_t n = front_of_.size();
  normals_.assign(factors_.size(), Normal());
  slots_of_.assign(n, {});
  diagonal_.assign(n, Vector<B>::Zero());
  hubs_.clear();
  row_of_.assign(n, -1);
  thread_row_of_.clear();
  local_.clear();
  is_affected_.clear();
  moved_.clear();
  position_.clear();
  stamp_of_.clear();
  stamp_ = 0;
  history_.clear();
  for (int slot = 0; slot < Slots(); ++slot) {
    if (factors_[At(slot)].first < 0) continue;
    SetSlot(slot, factors_[At(slot)]);
    Attach(slot);
  }
  for (int v = 0; v < Variables(); ++v) RecountDiagonal(v);
}

// Every variable is pivot of one front, every front is a root or child of one, separators are variables further up.
template <int B>
std::string BlockCholesky<B>::FindTreeDefect() const {
  const size_t n = front_of_.size(), count = fronts_.size();
  if (solution_.size() != n * B || !AreBelow(front_of_, count) || !AreBelow(roots_, count) ||
      !AreBelow(waiting_, count) || !AreBelow(free_fronts_, count)) {
    return "the parts of the factor have different sizes";
  }
  for (const Front& front : fronts_) {
    if (!AreBelow(front.pivots, n) || !AreBelow(front.separators, n) || !AreBelow(front.children, count) ||
        !AreBelow(front.slots, factors_.size()) || front.parent < -1) {
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
    const Front& front = fronts_[At(f)];
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
std::string BlockCholesky<B>::FindSlotDefect() const {
  const int n = Variables();
  size_t living = 0;
  for (const LinearFactor<B>& f : factors_) {
    if (f.first < -1 || f.first >= n || f.second < -1 || f.second >= n || (f.first >= 0 && f.first == f.second)) {
      return "a linear factor names a variable that there is not";
    }
    living += f.first >= 0 ? 1 : 0;
  }
  std::vector<char> is_taken(factors_.size(), 0);
  if (!AreBelow(free_slots_, factors_.size())) return "a free slot that there is not";
  for (const int slot : free_slots_) {
    if (std::exchange(is_taken[At(slot)], 1) != 0 || factors_[At(slot)].first >= 0) return "a free slot is in use";
  }
  if (living + free_slots_.size() != factors_.size()) return "a slot is neither free nor in use";
  std::vector<int> seen_in(front_of_.size(), -1);
  for (int f = 0; f < static_cast<int>(fronts_.size()); ++f) {
    const Front& front = fronts_[At(f)];
    if (front.pivots.empty() && !front.slots.empty()) return "a free front has factors";
    for (const int v : front.pivots) seen_in[At(v)] = f;
    for (const int v : front.separators) seen_in[At(v)] = f;
    living -= front.slots.size();
    for (const int slot : front.slots) {
      const LinearFactor<B>& factor = factors_[At(slot)];
      if (std::exchange(is_taken[At(slot)], 1) != 0) return "a linear factor is in two fronts, or in one and free";
      if (seen_in[At(factor.first)] != f || (factor.second >= 0 && seen_in[At(factor.second)] != f)) {
        return "a front lacks a variable of its factor";
      }
    }
  }
  return living == 0 ? "" : "a linear factor is in no front";
}

#define TERSE_INSTANTIATE(B)                                     \
  template void BlockCholesky<B>::RebuildDerived();              \
  template std::string BlockCholesky<B>::FindTreeDefect() const; \
  template std::string BlockCholesky<B>::FindSlotDefect() const; \
  template void BlockCholesky<B>::Serialize(StateWriter&);       \
  template void BlockCholesky<B>::Serialize(StateReader&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
