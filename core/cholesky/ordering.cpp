#include "cholesky/ordering.h"

#include <ccolamd.h>
#include <scotch/scotch.h>

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
// Cliques are written as pairs if these are at most so many per variable.
constexpr size_t kPairs = 200;

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

// Each pair of variables that share a clique, in both directions, but for those without a number. Variable v has
// neighbours[start[v]] to neighbours[start[v + 1] - 1].
struct Adjacency {
  std::vector<SCOTCH_Num> start, neighbours;
};

Adjacency AdjacencyOf(int variables, const Cliques& cliques, const std::vector<int>& number_of) {
  const auto visit_pairs = [&](const auto& visit) {
    for (int c = 0; c < cliques.Count(); ++c) {
      for (int a = cliques.start[At(c)]; a < cliques.start[At(c) + 1]; ++a) {
        const int i = number_of[At(cliques.members[At(a)])];
        if (i < 0) continue;
        for (int b = cliques.start[At(c)]; b < cliques.start[At(c) + 1]; ++b) {
          const int j = number_of[At(cliques.members[At(b)])];
          if (j >= 0 && i != j) visit(i, j);
        }
      }
    }
  };
  std::vector<SCOTCH_Num> end(At(variables) + 1, 0);
  visit_pairs([&](int i, int) { ++end[At(i) + 1]; });
  for (int v = 0; v < variables; ++v) end[At(v) + 1] += end[At(v)];
  Adjacency out;
  out.neighbours.resize(At(end.back()));
  out.start = end;
  visit_pairs([&](int i, int j) { out.neighbours[At(end[At(i)]++)] = j; });
  // Each neighbour once.
  std::vector<int> seen_by(At(variables), -1);
  SCOTCH_Num next = 0;
  for (int i = 0; i < variables; ++i) {
    const SCOTCH_Num begin = std::exchange(out.start[At(i)], next);
    for (SCOTCH_Num k = begin; k < end[At(i)]; ++k) {
      const SCOTCH_Num j = out.neighbours[At(k)];
      if (std::exchange(seen_by[At(j)], i) != i) out.neighbours[At(next++)] = j;
    }
  }
  out.start.back() = next;
  out.neighbours.resize(At(next));
  return out;
}

bool HasFewPairs(int variables, const Cliques& cliques) {
  size_t pairs = 0;
  for (int c = 0; c < cliques.Count(); ++c) {
    const size_t size = At(cliques.start[At(c) + 1] - cliques.start[At(c)]);
    pairs += size * size;
  }
  return pairs <= kPairs * At(variables);
}

// Down to parts that halo minimum degree orders as well.
constexpr const char* kStrategy =
    "n{sep=/(vert>150)?m{vert=100,low=h{pass=10},asc=b{width=3,bnd=f{bal=0.2},org=h{pass=10}f{bal=0.2}}};,"
    "ole=d{cmin=0,cmax=1000000,frat=0.0},ose=s}";

// What SCOTCH makes and wants freed.
template <class Item, void (*Exit)(Item*)>
class Scotch {
 public:
  explicit Scotch(int (*init)(Item*)) { Check(init(&item_)); }
  ~Scotch() { Exit(&item_); }
  Scotch(const Scotch&) = delete;
  Scotch& operator=(const Scotch&) = delete;
  Item* Get() { return &item_; }
  static void Check(int status) {
    if (status != 0) throw std::bad_alloc();  // what else fails is excluded here
  }

 private:
  Item item_;
};

}  // namespace

std::vector<int> MinimumDegreeOrder(int variables, const Cliques& cliques, const std::vector<char>& order_last) {
  if (!HasHub(variables, cliques)) return MinimumDegree(variables, cliques, order_last, false);
  // Many parallel edges make no hub: to an order they are one.
  const Cliques distinct = DistinctCliques(cliques);
  return MinimumDegree(variables, distinct, order_last, HasHub(variables, distinct));
}

std::vector<int> NestedDissectionOrder(int variables, const Cliques& cliques, const std::vector<char>& order_last) {
  if (HasHub(variables, cliques) || !HasFewPairs(variables, cliques)) return {};
  std::vector<int> number_of(At(variables), -1), variable_of, last;
  for (int v = 0; v < variables; ++v) {
    if (order_last[At(v)] != 0) {
      last.push_back(v);
    } else {
      number_of[At(v)] = static_cast<int>(variable_of.size());
      variable_of.push_back(v);
    }
  }
  const int n = static_cast<int>(variable_of.size());
  if (n == 0) return last;
  const Adjacency adjacency = AdjacencyOf(n, cliques, number_of);

  using Context = Scotch<SCOTCH_Context, SCOTCH_contextExit>;
  Context context(SCOTCH_contextInit);
  // The order depends on nothing that happened before or beside.
  Context::Check(SCOTCH_contextOptionSetNum(context.Get(), SCOTCH_OPTIONNUMDETERMINISTIC, 1));
  Context::Check(SCOTCH_contextOptionSetNum(context.Get(), SCOTCH_OPTIONNUMRANDOMFIXEDSEED, 1));
  Context::Check(SCOTCH_contextThreadSpawn(context.Get(), 1, nullptr));
  Context::Check(SCOTCH_contextRandomClone(context.Get()));
  SCOTCH_contextRandomSeed(context.Get(), 1);
  SCOTCH_contextRandomReset(context.Get());
  using Graph = Scotch<SCOTCH_Graph, SCOTCH_graphExit>;
  Graph graph(SCOTCH_graphInit), bound(SCOTCH_graphInit);
  Graph::Check(SCOTCH_graphBuild(graph.Get(), 0, n, adjacency.start.data(), nullptr, nullptr, nullptr,
                                 static_cast<SCOTCH_Num>(adjacency.neighbours.size()), adjacency.neighbours.data(),
                                 nullptr));
  Graph::Check(SCOTCH_contextBindGraph(context.Get(), graph.Get(), bound.Get()));
  using Strategy = Scotch<SCOTCH_Strat, SCOTCH_stratExit>;
  Strategy strategy(SCOTCH_stratInit);
  Strategy::Check(SCOTCH_stratGraphOrder(strategy.Get(), kStrategy));
  std::vector<SCOTCH_Num> order(At(n));
  Graph::Check(SCOTCH_graphOrder(bound.Get(), strategy.Get(), nullptr, order.data(), nullptr, nullptr, nullptr));
  std::vector<int> out;
  out.reserve(At(variables));
  for (const SCOTCH_Num k : order) out.push_back(variable_of[At(static_cast<int>(k))]);
  out.insert(out.end(), last.begin(), last.end());
  return out;
}

}  // namespace terse::internal
