#include <algorithm>
#include <stdexcept>
#include <utility>

#include "terse/core/pose_graph.h"

namespace terse {
namespace {

using std::size_t;

// Fenwick, SPE 1994: the node i (from 1) counts the lowest-bit-of-i positions that end at i.
constexpr size_t LowestBit(size_t i) { return i & (~i + 1); }

}  // namespace

template <class Pose>
const FactorNode<Pose>& FactorList<Pose>::at(size_t k) const {
  if (k >= size()) throw std::out_of_range("there are fewer factors");
  return (*this)[k];
}

template <class Pose>
const FactorNode<Pose>* FactorList<Pose>::Find(FactorId id) const {
  // Where none was ever removed, an id is its own place.
  const size_t own = id.value < 0 ? nodes_.size() : static_cast<size_t>(id.value);
  if (own < nodes_.size() && nodes_[own].id == id) return is_gap_[own] ? nullptr : &nodes_[own];
  const auto it = std::lower_bound(nodes_.begin(), nodes_.end(), id,
                                   [](const Node& node, FactorId wanted) { return node.id < wanted; });
  if (it == nodes_.end() || it->id != id || is_gap_[static_cast<size_t>(it - nodes_.begin())]) return nullptr;
  return &*it;
}

template <class Pose>
void FactorList<Pose>::Append(FactorId id, const Factor<Pose>& factor) {
  nodes_.push_back({id, factor});
  is_gap_.push_back(false);
  const size_t i = nodes_.size();
  int count = 0;
  for (size_t below = i - 1; gaps_ > 0 && below > i - LowestBit(i); below -= LowestBit(below)) {
    count += gap_counts_[below - 1];
  }
  gap_counts_.push_back(count);
}

template <class Pose>
bool FactorList<Pose>::Remove(FactorId id) {
  const Node* node = Find(id);
  if (node == nullptr) return false;
  const size_t position = static_cast<size_t>(node - nodes_.data());
  is_gap_[position] = true;
  for (size_t i = position + 1; i <= nodes_.size(); i += LowestBit(i)) ++gap_counts_[i - 1];
  ++gaps_;
  if (gaps_ > size()) CloseGaps();
  return true;
}

// The position with k living ones before it that is no gap itself.
template <class Pose>
size_t FactorList<Pose>::PositionOf(size_t k) const {
  size_t stride = 1, position = 0;
  while (2 * stride <= nodes_.size()) stride *= 2;
  for (; stride > 0; stride /= 2) {
    const size_t next = position + stride;
    if (next > nodes_.size()) continue;
    const size_t living = stride - static_cast<size_t>(gap_counts_[next - 1]);
    if (living > k) continue;
    k -= living;
    position = next;
  }
  return position;
}

template <class Pose>
void FactorList<Pose>::CloseGaps() {
  size_t kept = 0;
  for (size_t position = 0; position < nodes_.size(); ++position) {
    if (is_gap_[position]) continue;
    if (kept != position) nodes_[kept] = std::move(nodes_[position]);
    ++kept;
  }
  nodes_.erase(nodes_.begin() + static_cast<std::ptrdiff_t>(kept), nodes_.end());
  is_gap_.assign(kept, false);
  gap_counts_.assign(kept, 0);
  gaps_ = 0;
}

template class FactorList<SE2>;
template class FactorList<SE3>;

}  // namespace terse
