#include "cholesky/back_substitution.h"

#include <algorithm>
#include <unordered_set>

#include "terse/core/front_paths.h"

namespace terse::internal {

// One front's part of d. Lists the variables that moved enough.
template <int B>
void BackSubstitution<B>::Visit(Front<B>& front, const BlockSystem<B>& system, double threshold,
                                std::vector<double>& solution, std::vector<int>& changed) {
  x_.resize(At(front.Rows()));
  double* const d = solution.data();
  double* const moved = moved_.data();
  front.CopyRightHandSide(x_.data());
  BackSubstituteFront(front, d, x_.data());
  front.panel.Release();
  for (std::size_t k = 0; k < front.pivots.size(); ++k) {
    const int v = front.pivots[k];
    Eigen::Map<Vector<B>> old(d + At(v) * B);
    const Eigen::Map<const Vector<B>> value(x_.data() + k * B);
    const double change = (value - old).cwiseAbs2().dot(system.DiagonalOf(v));
    if (change <= threshold) continue;
    old = value;
    moved[At(v)] = change;
    changed.push_back(v);
  }
}

// What was not visited waits; each once, or what is visited again would make its children wait once more, and so on.
template <int B>
void BackSubstitution<B>::Defer(const std::vector<Entry>& stack, FrontTree<B>& tree) {
  std::unordered_set<int> seen;
  for (const Entry& entry : stack) {
    Front<B>& front = tree[entry.second];
    if ((!front.fresh && entry.first == 0) || front.pivots.empty() || !seen.insert(entry.second).second) continue;
    front.fresh = true;
    tree.Wait(entry.second);
  }
}

template <int B>
std::vector<int> BackSubstitution<B>::Solve(FrontTree<B>& tree, const BlockSystem<B>& system, double threshold,
                                            std::optional<Clock::time_point> deadline, std::vector<double>& solution,
                                            SolveReport& report) {
  moved_.resize(At(system.Variables()), 0.0);
  report = {};
  std::vector<int> changed;
  std::vector<Entry> stack;
  const std::vector<int> waiting = tree.TakeWaiting();
  for (auto it = waiting.rbegin(); it != waiting.rend(); ++it) stack.emplace_back(0.0, *it);
  for (const int f : tree.Roots()) stack.emplace_back(0.0, f);
  // With a deadline a heap.
  if (deadline) std::make_heap(stack.begin(), stack.end());
  while (!stack.empty()) {
    if (deadline) {
      if (report.flops > 0 && Clock::now() > *deadline) break;
      std::pop_heap(stack.begin(), stack.end());
    }
    const double above = stack.back().first;
    Front<B>& front = tree[stack.back().second];
    stack.pop_back();
    // Nothing changed here; a front that was refactored below has refactored ancestors, or waits itself.
    if (!front.fresh && above == 0) continue;
    if (front.pivots.empty()) continue;  // waited and is no more
    front.fresh = false;
    Visit(front, system, threshold, solution, changed);
    const double rows = front.Rows(), p = front.Columns();
    report.flops += 2.0 * rows * p - 1.0 * p * p;
    for (const int child : front.children) {
      const Front<B>& below = tree[child];
      double largest = 0;
      for (const int v : below.separators) largest = std::max(largest, moved_[At(v)]);
      if (!(largest > 0 || below.fresh)) continue;
      stack.emplace_back(largest, child);
      if (deadline) std::push_heap(stack.begin(), stack.end());
    }
  }
  Defer(stack, tree);
  report.deferred = tree.Waiting();
  for (const int v : changed) moved_[At(v)] = 0;
  return changed;
}

template class BackSubstitution<3>;
template class BackSubstitution<6>;

}  // namespace terse::internal
