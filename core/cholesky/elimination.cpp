#include "cholesky/elimination.h"

#include <ccolamd.h>

#include <algorithm>
#include <cmath>
#include <new>
#include <stdexcept>

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

}  // namespace

std::vector<SymbolicFront> Eliminate(int variables, const Cliques& cliques, const std::vector<char>& order_last) {
  const size_t n = static_cast<size_t>(variables);
  const std::vector<int> order = Order(variables, cliques, order_last);
  std::vector<int> position(n);
  for (size_t k = 0; k < n; ++k) position[static_cast<size_t>(order[k])] = static_cast<int>(k);

  // Each clique waits at its earliest variable, each finished front at its earliest separator.
  std::vector<int> clique_next(static_cast<size_t>(cliques.Count()), -1), clique_first(n, -1);
  for (int c = cliques.Count() - 1; c >= 0; --c) {
    int earliest = variables;
    for (int k = cliques.start[static_cast<size_t>(c)]; k < cliques.start[static_cast<size_t>(c) + 1]; ++k) {
      earliest = std::min(earliest, position[static_cast<size_t>(cliques.members[static_cast<size_t>(k)])]);
    }
    if (earliest == variables) continue;
    clique_next[static_cast<size_t>(c)] = clique_first[static_cast<size_t>(earliest)];
    clique_first[static_cast<size_t>(earliest)] = c;
  }
  std::vector<int> front_next(n, -1), front_first(n, -1);  // fronts are named by their last pivot
  std::vector<WorkFront> fronts(n);
  std::vector<int> mark(n, -1);
  for (int k = 0; k < variables; ++k) {
    const size_t at = static_cast<size_t>(k);
    WorkFront& front = fronts[at];
    mark[at] = k;
    const auto add = [&](int other) {
      if (mark[static_cast<size_t>(other)] == k) return;
      mark[static_cast<size_t>(other)] = k;
      front.separators.push_back(other);
    };
    for (int c = clique_first[at]; c >= 0; c = clique_next[static_cast<size_t>(c)]) {
      for (int m = cliques.start[static_cast<size_t>(c)]; m < cliques.start[static_cast<size_t>(c) + 1]; ++m) {
        add(position[static_cast<size_t>(cliques.members[static_cast<size_t>(m)])]);
      }
    }
    std::vector<int> children;
    for (int f = front_first[at]; f >= 0; f = front_next[static_cast<size_t>(f)]) {
      children.push_back(f);
      for (const int other : fronts[static_cast<size_t>(f)].separators) add(other);
    }
    std::sort(front.separators.begin(), front.separators.end());
    front.pivots = {k};
    // Best candidates first: the child with the largest separator adds the fewest zeros per pivot.
    std::sort(children.begin(), children.end(), [&](int a, int b) {
      const size_t size_a = fronts[static_cast<size_t>(a)].separators.size();
      const size_t size_b = fronts[static_cast<size_t>(b)].separators.size();
      return size_a != size_b ? size_a > size_b : a < b;
    });
    for (const int f : children) {
      WorkFront& child = fronts[static_cast<size_t>(f)];
      const long child_pivots = static_cast<long>(child.pivots.size());
      const long added =
          child_pivots * static_cast<long>(front.pivots.size() + front.separators.size() - child.separators.size());
      const long zeros = front.zeros + child.zeros + added;
      if (!WorthMerging(child_pivots + static_cast<long>(front.pivots.size()),
                        static_cast<long>(front.separators.size()), zeros))
        continue;
      front.zeros = zeros;
      child.pivots.insert(child.pivots.end(), front.pivots.begin(), front.pivots.end());
      front.pivots = std::move(child.pivots);
      child = WorkFront();
    }
    if (!front.separators.empty()) {
      const size_t up = static_cast<size_t>(front.separators.front());
      front_next[at] = front_first[up];
      front_first[up] = k;
    }
  }

  // Number the surviving fronts and name variables again.
  std::vector<int> front_of(n, -1);
  std::vector<SymbolicFront> out;
  for (WorkFront& work : fronts) {
    if (work.pivots.empty()) continue;
    SymbolicFront front;
    for (const int k : work.pivots) {
      front_of[static_cast<size_t>(k)] = static_cast<int>(out.size());
      front.pivots.push_back(order[static_cast<size_t>(k)]);
      for (int c = clique_first[static_cast<size_t>(k)]; c >= 0; c = clique_next[static_cast<size_t>(c)])
        front.cliques.push_back(c);
    }
    for (const int k : work.separators) front.separators.push_back(order[static_cast<size_t>(k)]);
    out.push_back(std::move(front));
  }
  for (SymbolicFront& front : out) {
    if (!front.separators.empty()) {
      front.parent = front_of[static_cast<size_t>(position[static_cast<size_t>(front.separators.front())])];
    }
  }
  return out;
}

}  // namespace terse::internal
