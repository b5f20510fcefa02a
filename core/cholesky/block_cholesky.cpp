#include "terse/core/block_cholesky.h"

#include <algorithm>
#include <stdexcept>
#include <unordered_set>

#include "support/version.h"
#include "terse/core/dense_kernels.h"
#include "terse/core/parallel.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

constexpr size_t kChunk = 256;  // factors or variables that a thread takes at a time

}  // namespace

std::uint64_t internal::Identity::Next() { return NextVersion(); }

template <int B>
void BlockCholesky<B>::SetThreads(int threads) {
  if (threads < 1) throw std::invalid_argument("at least one thread is needed");
  threads_ = threads;
}

template <int B>
void BlockCholesky<B>::SetFactors(const std::vector<LinearFactor<B>>& factors) {
  if (factors.size() > factors_.size()) throw std::invalid_argument("no such factor slot");
  for (size_t k = 0; k < factors.size(); ++k) {
    if (factors_[k].first != factors[k].first || factors_[k].second != factors[k].second) {
      throw std::invalid_argument("a factor may not change its variables");
    }
  }
  internal::SpreadChunks(threads_, factors.size(), kChunk, [&](size_t begin, size_t end) {
    for (size_t k = begin; k < end; ++k) SetSlot(static_cast<int>(k), factors[k]);
  });
  internal::SpreadChunks(threads_, front_of_.size(), kChunk, [&](size_t begin, size_t end) {
    for (size_t v = begin; v < end; ++v) {
      if (hubs_.count(static_cast<int>(v)) == 0) RecountDiagonal(static_cast<int>(v));
    }
  });
  for (const auto& hub : hubs_) RecountDiagonal(hub.first);
}

template <int B>
bool BlockCholesky<B>::Refactor(const std::vector<double>& damping) {
  version_ = internal::NextVersion();
  history_.clear();
  const std::vector<int> order = TopDown();
  position_.resize(fronts_.size(), 0);
  std::vector<Front*> fronts;
  std::vector<int> parents(order.size(), -1);
  for (auto it = order.rbegin(); it != order.rend(); ++it) {
    position_[At(*it)] = static_cast<int>(fronts.size());
    fronts.push_back(&fronts_[At(*it)]);
  }
  for (size_t k = 0; k < fronts.size(); ++k) {
    if (fronts[k]->parent >= 0) parents[k] = position_[At(fronts[k]->parent)];
  }
  double flops = 0;
  if (FactorFronts(fronts, parents, {}, damping, flops) >= 0) return false;
  log_det_ = y2_ = 0;
  for (const int f : order) {
    fronts_[At(f)].fresh = true;
    fronts_[At(f)].stamp = version_;
    log_det_ += fronts_[At(f)].log_det;
    y2_ += fronts_[At(f)].y2;
  }
  return true;
}

// Fronts with parents before children.
template <int B>
std::vector<int> BlockCholesky<B>::TopDown() const {
  std::vector<int> order(roots_);
  for (size_t k = 0; k < order.size(); ++k) {
    const auto& children = fronts_[At(order[k])].children;
    order.insert(order.end(), children.begin(), children.end());
  }
  return order;
}

template <int B>
std::vector<int> BlockCholesky<B>::Solve(double threshold, std::optional<Clock::time_point> deadline) {
  moved_.resize(front_of_.size(), 0.0);
  last_solve_ = {};
  std::vector<int> changed;
  using Entry = std::pair<double, int>;  // what moved most among the separators, front
  std::vector<Entry> stack;
  for (auto it = waiting_.rbegin(); it != waiting_.rend(); ++it) stack.emplace_back(0.0, *it);
  for (const int f : roots_) stack.emplace_back(0.0, f);
  waiting_.clear();
  std::vector<double> x;
  while (!stack.empty()) {
    if (deadline && last_solve_.flops > 0) {
      if (Clock::now() > *deadline) break;
      std::iter_swap(std::max_element(stack.begin(), stack.end()), stack.end() - 1);
    }
    const double above = stack.back().first;
    Front& front = fronts_[At(stack.back().second)];
    stack.pop_back();
    // Nothing changed here; a front that was refactored below has refactored ancestors, or waits itself.
    if (!front.fresh && above == 0) continue;
    if (front.pivots.empty()) continue;  // waited and is no more
    front.fresh = false;
    const int rows = front.Rows(), p = front.Columns();
    x.resize(At(rows));
    double* separators = x.data() + p;
    for (const int v : front.separators) separators = std::copy_n(solution_.data() + At(v) * B, B, separators);
    internal::Kernels().back_substitute(front.panel.data(), rows, p, x.data());
    last_solve_.flops += 2.0 * rows * p - 1.0 * p * p;
    for (size_t k = 0; k < front.pivots.size(); ++k) {
      const int v = front.pivots[k];
      Eigen::Map<Vector<B>> old(solution_.data() + At(v) * B);
      const Eigen::Map<const Vector<B>> value(x.data() + k * B);
      const double change = (value - old).cwiseAbs2().dot(diagonal_[At(v)]);
      if (change <= threshold) continue;
      old = value;
      moved_[At(v)] = change;
      changed.push_back(v);
    }
    for (const int child : front.children) {
      double largest = 0;
      for (const int v : fronts_[At(child)].separators) largest = std::max(largest, moved_[At(v)]);
      if (largest > 0 || fronts_[At(child)].fresh) stack.emplace_back(largest, child);
    }
  }
  // Each once, or what is visited again would make its children wait once more, and so on.
  std::unordered_set<int> seen;
  for (const Entry& entry : stack) {
    Front& front = fronts_[At(entry.second)];
    if ((!front.fresh && entry.first == 0) || front.pivots.empty() || !seen.insert(entry.second).second) continue;
    front.fresh = true;
    waiting_.push_back(entry.second);
  }
  last_solve_.deferred = static_cast<int>(waiting_.size());
  for (const int v : changed) moved_[At(v)] = 0;
  return changed;
}

template <int B>
void BlockCholesky<B>::SetSolution(int variable, const Vector<B>& d) {
  std::copy_n(d.data(), B, solution_.begin() + static_cast<long>(variable) * B);
}

template <int B>
std::vector<double> BlockCholesky<B>::Gradient() const {
  std::vector<double> b(front_of_.size() * B, 0.0);
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
std::vector<double> BlockCholesky<B>::Diagonal() const {
  std::vector<double> d;
  d.reserve(diagonal_.size() * B);
  for (const Vector<B>& v : diagonal_) d.insert(d.end(), v.data(), v.data() + B);
  return d;
}

template <int B>
std::int64_t BlockCholesky<B>::FactorNonzeros() const {
  std::int64_t sum = 0;
  for (const auto& front : fronts_) {
    const std::int64_t p = front.Columns(), rows = front.pivots.empty() ? 0 : front.Rows() - 1;
    sum += p * rows - p * (p - 1) / 2;
  }
  return sum;
}

template class BlockCholesky<3>;
template class BlockCholesky<6>;

}  // namespace terse
