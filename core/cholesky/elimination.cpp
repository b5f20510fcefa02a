#include "cholesky/elimination.h"

#include <algorithm>
#include <stdexcept>
#include <string>
#include <utility>

#include "terse/core/at.h"

namespace terse::internal {
namespace {

using std::size_t;

// Nested dissection takes some microseconds per variable. It is tried from so many variables on, where minimum degree
// leaves so many flops (of blocks) for each: more where only a few factorisations profit from it.
constexpr int kLeastDissected = 60;
constexpr double WorthDissecting(OrderFor purpose) { return purpose == OrderFor::kUpdates ? 250 : 1000; }
// In an incremental run an update of one path counts as this part of a factorisation of everything.
constexpr double kUpdatesPerFactorisation = 1000;

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

double FactorCost::Add(double pivots, double separators, double above) {
  const double rows = pivots + separators;
  flops += (rows * rows * rows - separators * separators * separators) / 3;
  const double entries = pivots * (pivots + 1) / 2 + pivots * separators;
  paths += pivots * (above + entries);
  return above + entries;
}

FactorCost CostOf(const std::vector<SymbolicFront>& fronts) {
  FactorCost cost;
  std::vector<double> path(fronts.size());
  for (size_t k = fronts.size(); k-- > 0;) {
    const SymbolicFront& front = fronts[k];
    path[k] = cost.Add(static_cast<double>(front.pivots.size()), static_cast<double>(front.separators.size()),
                       front.parent >= 0 ? path[At(front.parent)] : 0.0);
  }
  return cost;
}

void RequireOrder(const std::vector<int>& order, size_t variables) {
  if (order.empty() || order.size() == variables) return;
  throw std::invalid_argument("an elimination order of " + std::to_string(order.size()) + " poses is given for " +
                              std::to_string(variables));
}

std::vector<SymbolicFront> EliminateInOrder(const Cliques& cliques, std::vector<int> order) {
  Elimination elimination(cliques, std::move(order));
  elimination.Run();
  return elimination.Fronts();
}

std::vector<SymbolicFront> Eliminate(int variables, const Cliques& cliques, const std::vector<char>& order_last,
                                     OrderFor purpose) {
  std::vector<SymbolicFront> fronts = EliminateInOrder(cliques, MinimumDegreeOrder(variables, cliques, order_last));
  const FactorCost cost = CostOf(fronts);
  if (variables < kLeastDissected || cost.flops < WorthDissecting(purpose) * variables) return fronts;
  std::vector<int> order = NestedDissectionOrder(variables, cliques, order_last);
  if (order.empty()) return fronts;
  std::vector<SymbolicFront> dissected = EliminateInOrder(cliques, std::move(order));
  const auto total = [&](const FactorCost& c) {
    return c.flops + (purpose == OrderFor::kUpdates ? kUpdatesPerFactorisation * c.paths / variables : 0.0);
  };
  return total(CostOf(dissected)) < total(cost) ? dissected : fronts;
}

}  // namespace terse::internal
