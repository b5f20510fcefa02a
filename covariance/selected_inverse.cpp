#include "terse/covariance/selected_inverse.h"

#include <algorithm>
#include <set>

#include "front_covariance.h"
#include "terse/covariance/covariance_blocks.h"

namespace terse {
namespace {

using internal::At;
using internal::FrontScratch;
using internal::PivotRow;
using std::size_t;

// Measured: a flop of single substitutions takes about as long as so many of the recursion's products.
constexpr double kSolveFlop = 2.5;

// Of forward substitution from one variable to the root.
template <int B>
double SolveFlops(const BlockCholesky<B>& factor, int variable) {
  double flops = 0;
  for (int f = factor.FrontOf(variable); f >= 0; f = factor.FrontAt(f).parent) {
    const double p = factor.FrontAt(f).Columns(), rows = factor.FrontAt(f).Rows() - 1;
    flops += 2.0 * B * p * (rows - p / 2);
  }
  return flops;
}

}  // namespace

// The fronts from this one up to the first whose block is good, and the largest stamp up to the root.
template <int B>
std::vector<int> SelectedInverse<B>::StalePath(int front, std::uint64_t& stamp) const {
  std::vector<int> path;
  for (int f = front; f >= 0; f = factor_->FrontAt(f).parent) path.push_back(f);
  stamp = 0;
  size_t stale = path.size();
  while (stale > 0) {
    stamp = std::max(stamp, factor_->FrontAt(path[stale - 1]).stamp);
    const auto it = cache_.find(path[stale - 1]);
    if (it == cache_.end() || it->second->stamp < stamp) break;
    --stale;
  }
  path.resize(stale);
  for (size_t k = 0; k < stale; ++k) stamp = std::max(stamp, factor_->FrontAt(path[k]).stamp);
  return path;
}

template <int B>
typename SelectedInverse<B>::BlockPointer SelectedInverse<B>::Front(int id) const {
  std::uint64_t stamp = 0;
  const std::vector<int> path = StalePath(id, stamp);
  FrontScratch scratch;
  BlockPointer block;
  const int above = path.empty() ? id : factor_->FrontAt(path.back()).parent;
  if (above >= 0) block = cache_.at(above);
  for (auto it = path.rbegin(); it != path.rend(); ++it) {
    const auto& front = factor_->FrontAt(*it);
    const BlockPointer parent = block;
    std::vector<int> rows;
    if (parent) {
      internal::SetRows<B>(factor_->FrontAt(front.parent), factor_->Variables(), scratch);
      internal::SeparatorRows<B>(front, scratch, rows);
    }
    block = std::make_shared<Block>();
    block->n = front.Rows() - 1;
    block->covariance.resize(At(block->n) * At(block->n));
    internal::ComputeFrontCovariance<B>(front, parent ? parent->covariance.data() : nullptr, parent ? parent->n : 0,
                                        rows, false, block->covariance.data(), scratch);
    block->stamp = factor_->Version();
    BlockPointer& kept = cache_[*it];
    if (kept) bytes_ -= kept->covariance.size() * sizeof(double);
    kept = block;
    bytes_ += block->covariance.size() * sizeof(double);
  }
  for (int f = id; f >= 0; f = factor_->FrontAt(f).parent) cache_.at(f)->used = queries_;
  return block;
}

// Down to the capacity, the longest unused first.
template <int B>
void SelectedInverse<B>::Evict() const {
  if (bytes_ <= capacity_) return;
  std::vector<std::pair<std::uint64_t, int>> oldest;
  for (const auto& [front, block] : cache_) oldest.emplace_back(block->used, front);
  std::sort(oldest.begin(), oldest.end());
  for (const auto& [used, front] : oldest) {
    if (bytes_ <= capacity_) return;
    const auto it = cache_.find(front);
    bytes_ -= it->second->covariance.size() * sizeof(double);
    cache_.erase(it);
  }
}

template <int B>
std::vector<Matrix<B, B>> SelectedInverse<B>::Diagonals(const std::vector<int>& variables,
                                                        DiagonalMethod method) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  ++queries_;
  if (std::exchange(identity_, factor_->Identity()) != factor_->Identity()) {
    cache_.clear();
    bytes_ = 0;
  }
  if (method == DiagonalMethod::kCheapest && variables.size() == 1 && cache_.empty()) method = DiagonalMethod::kSolve;
  if (method == DiagonalMethod::kCheapest) {
    double solve = 0, recursion = 0;
    std::set<int> stale;
    for (const int v : variables) {
      std::uint64_t stamp = 0;
      for (const int f : StalePath(factor_->FrontOf(v), stamp)) {
        if (stale.insert(f).second) recursion += internal::RecursionFlops<B>(factor_->FrontAt(f));
      }
      solve += SolveFlops(*factor_, v);
    }
    method = kSolveFlop * solve < recursion ? DiagonalMethod::kSolve : DiagonalMethod::kRecursion;
  }
  std::vector<Matrix<B, B>> out;
  out.reserve(variables.size());
  for (const int v : variables) {
    if (method == DiagonalMethod::kSolve) {
      out.push_back(JointCovariance(*factor_, {v}));
      continue;
    }
    const int id = factor_->FrontOf(v);
    const BlockPointer block = Front(id);
    const Eigen::Index at = PivotRow<B>(factor_->FrontAt(id), v);
    out.push_back(Eigen::Map<const MatrixX>(block->covariance.data(), block->n, block->n).template block<B, B>(at, at));
    Evict();
  }
  return out;
}

template <int B>
std::vector<Matrix<B, B>> SelectedInverse<B>::AllDiagonals() const {
  // The buffers of an earlier call, if no other thread has them.
  std::unique_ptr<internal::RecursionScratch> scratch;
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    scratch.swap(scratch_);
  }
  if (!scratch) scratch = std::make_unique<internal::RecursionScratch>();
  std::vector<Matrix<B, B>> out;
  internal::ComputeAllDiagonals(*factor_, out, *scratch);
  const std::lock_guard<std::mutex> lock(mutex_);
  scratch.swap(scratch_);
  return out;
}

template <int B>
SelectedInverse<B>::SelectedInverse(const BlockCholesky<B>& factor, std::size_t cache_bytes)
    : factor_(&factor), capacity_(cache_bytes) {}

template <int B>
SelectedInverse<B>::~SelectedInverse() = default;

template <int B>
std::size_t SelectedInverse<B>::CacheBytes() const {
  const std::lock_guard<std::mutex> lock(mutex_);
  return bytes_;
}

template class SelectedInverse<3>;
template class SelectedInverse<6>;

}  // namespace terse
