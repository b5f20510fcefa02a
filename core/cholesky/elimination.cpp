#include "cholesky/elimination.h"

#include <ccolamd.h>

#include <algorithm>
#include <cmath>
#include <new>
#include <stdexcept>
#include <utility>

#include "terse/core/at.h"

namespace terse::internal {
namespace {

using std::size_t;

// A variable in more cliques than this is a hub. Minimum degree looks through all cliques of a hub whenever one of its
// neighbours is eliminated, so hubs are kept out of it and come last.
constexpr int kHub = 1000;

// Each set of two or more members once, in ascending order.
Cliques DistinctCliques(const Cliques& cliques) {
  std::vector<std::vector<int>> sets;
  for (int c = 0; c < cliques.Count(); ++c) {
    const auto begin = cliques.members.begin() + cliques.start[static_cast<size_t>(c)];
    const auto end = cliques.members.begin() + cliques.start[static_cast<size_t>(c) + 1];
    if (end - begin < 2) continue;
    sets.emplace_back(begin, end);
    std::sort(sets.back().begin(), sets.back().end());
  }
  std::sort(sets.begin(), sets.end());
  sets.erase(std::unique(sets.begin(), sets.end()), sets.end());
  Cliques out;
  for (const auto& set : sets) {
    out.members.insert(out.members.end(), set.begin(), set.end());
    out.Close();
  }
  return out;
}

bool HasHub(int variables, const Cliques& cliques) {
  std::vector<int> count(static_cast<size_t>(variables), 0);
  return std::any_of(cliques.members.begin(), cliques.members.end(),
                     [&](int v) { return ++count[static_cast<size_t>(v)] > kHub; });
}

// Elimination order, first to last, as variables. Where `withhold_hubs`, they come last.
std::vector<int> MinimumDegree(int variables, const Cliques& cliques, const std::vector<char>& order_last,
                               bool withhold_hubs) {
  const size_t n = static_cast<size_t>(variables);
  // Columns are variables, rows are cliques that couple something.
  std::vector<int> column_start(n + 1, 0);
  int rows = 0;
  for (int c = 0; c < cliques.Count(); ++c) {
    const int begin = cliques.start[static_cast<size_t>(c)], end = cliques.start[static_cast<size_t>(c) + 1];
    if (end - begin < 2) continue;
    ++rows;
    for (int k = begin; k < end; ++k) ++column_start[static_cast<size_t>(cliques.members[static_cast<size_t>(k)]) + 1];
  }
  for (size_t v = 0; v < n; ++v) column_start[v + 1] += column_start[v];
  const size_t entries = static_cast<size_t>(column_start[n]);
  const size_t length = ccolamd_recommended(static_cast<int>(entries), rows, variables);
  if (length == 0) throw std::length_error("the graph is too large to order");
  std::vector<int> indices(length);
  std::vector<int> next(column_start.begin(), column_start.end() - 1);
  int row = 0;
  for (int c = 0; c < cliques.Count(); ++c) {
    const int begin = cliques.start[static_cast<size_t>(c)], end = cliques.start[static_cast<size_t>(c) + 1];
    if (end - begin < 2) continue;
    for (int k = begin; k < end; ++k) {
      int& slot = next[static_cast<size_t>(cliques.members[static_cast<size_t>(k)])];
      indices[static_cast<size_t>(slot++)] = row;
    }
    ++row;
  }
  std::vector<int> member(n, 0);
  for (size_t v = 0; v < n; ++v) member[v] = order_last[v] != 0 ? 1 : 0;
  // Constraint sets must be numbered without gaps.
  if (std::find(member.begin(), member.end(), 0) == member.end()) std::fill(member.begin(), member.end(), 0);
  double knobs[CCOLAMD_KNOBS];
  ccolamd_set_defaults(knobs);
  knobs[CCOLAMD_DENSE_ROW] = -1;
  // CCOLAMD takes its limit as a multiple of this root.
  knobs[CCOLAMD_DENSE_COL] = withhold_hubs ? kHub / std::sqrt(std::max(1.0, 1.0 * std::min(rows, variables))) : -1;
  int stats[CCOLAMD_STATS];
  if (ccolamd(rows, variables, static_cast<int>(length), indices.data(), column_start.data(), knobs, stats,
              member.data()) == 0) {
    throw std::logic_error("ordering failed");
  }
  column_start.pop_back();
  return column_start;
}

std::vector<int> Order(int variables, const Cliques& cliques, const std::vector<char>& order_last) {
  if (!HasHub(variables, cliques)) return MinimumDegree(variables, cliques, order_last, false);
  // Many parallel edges make no hub: to an order they are one.
  const Cliques distinct = DistinctCliques(cliques);
  return MinimumDegree(variables, distinct, order_last, HasHub(variables, distinct));
}

struct WorkFront {
  std::vector<int> pivots, separators;  // positions in the elimination order
  long zeros = 0;                       // entries stored in vain because of merging
};

// Merging costs zeros and saves overhead; the tolerated share shrinks with the front's width.
bool WorthMerging(long pivots, long separators, long zeros) {
  if (zeros == 0) return true;
  const double entries = 0.5 * static_cast<double>(pivots * (pivots + 1)) + static_cast<double>(pivots * separators);
  const double share = static_cast<double>(zeros) / entries;
  if (pivots <= 4) return share < 0.25;
  if (pivots <= 16) return share < 0.10;
  return share < 0.05;
}

// Lists of numbers that wait at a place, each in one list.
struct WaitingLists {
  std::vector<int> first, next;  // -1: none
  WaitingLists(size_t places, size_t numbers) : first(places, -1), next(numbers, -1) {}
  void Put(int number, int place) { next[At(number)] = std::exchange(first[At(place)], number); }
  template <class Visit>
  void ForEach(int place, const Visit& visit) const {
    for (int number = first[At(place)]; number >= 0; number = next[At(number)]) visit(number);
  }
};

class Elimination {
 public:
  Elimination(const Cliques& cliques, std::vector<int> order)
      : cliques_(cliques),
        order_(std::move(order)),
        position_(order_.size()),
        waiting_cliques_(order_.size(), At(cliques.Count())),
        waiting_fronts_(order_.size(), order_.size()),
        fronts_(order_.size()),
        mark_(order_.size(), -1) {
    for (size_t k = 0; k < order_.size(); ++k) position_[At(order_[k])] = static_cast<int>(k);
    for (int c = cliques.Count() - 1; c >= 0; --c) {
      int earliest = Variables();
      ForEachMember(c, [&](int k) { earliest = std::min(earliest, k); });
      if (earliest < Variables()) waiting_cliques_.Put(c, earliest);
    }
  }
  void Run() {
    for (int k = 0; k < Variables(); ++k) EliminateNext(k);
  }
  std::vector<SymbolicFront> Fronts() const;

 private:
  int Variables() const { return static_cast<int>(order_.size()); }
  // visit(position in the order).
  template <class Visit>
  void ForEachMember(int clique, const Visit& visit) const {
    for (int m = cliques_.start[At(clique)]; m < cliques_.start[At(clique) + 1]; ++m) {
      visit(position_[At(cliques_.members[At(m)])]);
    }
  }
  void EliminateNext(int k);
  void MergeChildren(std::vector<int>& children, WorkFront& front);

  const Cliques& cliques_;
  std::vector<int> order_, position_;  // variable by position, position by variable
  WaitingLists waiting_cliques_;       // at their earliest variable
  WaitingLists waiting_fronts_;        // named by their last pivot, at their earliest separator
  std::vector<WorkFront> fronts_;
  std::vector<int> mark_;
};

// The front of a variable alone, and what of the fronts below joins it.
void Elimination::EliminateNext(int k) {
  WorkFront& front = fronts_[At(k)];
  mark_[At(k)] = k;
  const auto add = [&](int other) {
    if (std::exchange(mark_[At(other)], k) != k) front.separators.push_back(other);
  };
  waiting_cliques_.ForEach(k, [&](int c) { ForEachMember(c, add); });
  std::vector<int> children;
  waiting_fronts_.ForEach(k, [&](int f) {
    children.push_back(f);
    for (const int other : fronts_[At(f)].separators) add(other);
  });
  std::sort(front.separators.begin(), front.separators.end());
  front.pivots = {k};
  MergeChildren(children, front);
  if (!front.separators.empty()) waiting_fronts_.Put(k, front.separators.front());
}

void Elimination::MergeChildren(std::vector<int>& children, WorkFront& front) {
  // Best candidates first: the child with the largest separator adds the fewest zeros per pivot.
  std::sort(children.begin(), children.end(), [&](int a, int b) {
    const size_t size_a = fronts_[At(a)].separators.size(), size_b = fronts_[At(b)].separators.size();
    return size_a != size_b ? size_a > size_b : a < b;
  });
  for (const int f : children) {
    WorkFront& child = fronts_[At(f)];
    const long child_pivots = static_cast<long>(child.pivots.size());
    const long added =
        child_pivots * static_cast<long>(front.pivots.size() + front.separators.size() - child.separators.size());
    const long zeros = front.zeros + child.zeros + added;
    const long pivots = child_pivots + static_cast<long>(front.pivots.size());
    if (!WorthMerging(pivots, static_cast<long>(front.separators.size()), zeros)) continue;
    front.zeros = zeros;
    child.pivots.insert(child.pivots.end(), front.pivots.begin(), front.pivots.end());
    front.pivots = std::move(child.pivots);
    child = WorkFront();
  }
}

// Numbers the fronts that are left, and names variables as they were.
std::vector<SymbolicFront> Elimination::Fronts() const {
  std::vector<int> front_of(order_.size(), -1);
  std::vector<SymbolicFront> out;
  for (const WorkFront& work : fronts_) {
    if (work.pivots.empty()) continue;
    SymbolicFront front;
    for (const int k : work.pivots) {
      front_of[At(k)] = static_cast<int>(out.size());
      front.pivots.push_back(order_[At(k)]);
      waiting_cliques_.ForEach(k, [&](int c) { front.cliques.push_back(c); });
    }
    for (const int k : work.separators) front.separators.push_back(order_[At(k)]);
    out.push_back(std::move(front));
  }
  for (SymbolicFront& front : out) {
    if (!front.separators.empty()) front.parent = front_of[At(position_[At(front.separators.front())])];
  }
  return out;
}

}  // namespace

std::vector<SymbolicFront> Eliminate(int variables, const Cliques& cliques, const std::vector<char>& order_last) {
  Elimination elimination(cliques, Order(variables, cliques, order_last));
  elimination.Run();
  return elimination.Fronts();
}

}  // namespace terse::internal
