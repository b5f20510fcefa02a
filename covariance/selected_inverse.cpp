#include "terse/covariance/selected_inverse.h"

#include <algorithm>

#include "front_covariance.h"
#include "terse/covariance/covariance_blocks.h"

namespace terse {
namespace {

using internal::At;
using internal::PivotRow;
using std::size_t;

// Measured: a flop of single substitutions takes about as long as so many of the recursion's products.
constexpr double kSolveFlop = 2.5;
// From so many variables on, computing everything is considered.
constexpr size_t kMany = 16;

// Of forward substitution through one front.
template <int B>
double SolveFlops(const internal::Front<B>& front) {
  const double p = front.Columns(), rows = front.Rows() - 1;
  return 2 * B * p * (rows - p / 2);
}

}  // namespace

// Of all fronts from this one to the root; each is looked at once in a query.
template <int B>
const typename SelectedInverse<B>::Known& SelectedInverse<B>::Look(int front, Query& query) const {
  std::vector<int> path;
  Known above;
  cholesky_->Tree().Climb(front, [&](int f) {
    const auto known = query.known.find(f);
    if (known == query.known.end()) {
      path.push_back(f);
      return true;
    }
    above = known->second;
    return false;
  });
  for (auto it = path.rbegin(); it != path.rend(); ++it) {
    const auto& at = cholesky_->Tree()[*it];
    const auto cached = cache_.find(*it);
    above.stamp = std::max(above.stamp, at.stamp);
    above.solve_flops += SolveFlops<B>(at);
    const bool is_good = cached != cache_.end() && cached->second->stamp >= above.stamp;
    if (!is_good) query.recursion_flops += internal::RecursionFlops<B>(at);
    query.known[*it] = above;
  }
  return query.known[front];
}

// The block of a front, from the cache or computed with what is missing above it.
template <int B>
typename SelectedInverse<B>::BlockPointer SelectedInverse<B>::Front(int id, Query& query) const {
  std::vector<int> path;
  BlockPointer block;
  cholesky_->Tree().Climb(id, [&](int f) {
    const auto cached = cache_.find(f);
    if (cached != cache_.end() && cached->second->stamp >= Look(f, query).stamp) {
      block = cached->second;
      block->used = queries_;
      return false;
    }
    path.push_back(f);
    return true;
  });
  std::vector<int> rows;
  for (auto it = path.rbegin(); it != path.rend(); ++it) {
    const auto& front = cholesky_->Tree()[*it];
    const BlockPointer parent = block;
    if (parent) {
      internal::SetRows<B>(cholesky_->Tree()[front.parent], cholesky_->Variables(), scratch_->front);
      internal::SeparatorRows<B>(front, scratch_->front, rows);
    }
    block = std::make_shared<Block>();
    block->n = front.Rows() - 1;
    block->covariance.resize(At(block->n) * At(block->n));
    internal::ComputeFrontCovariance<B>(front, parent ? parent->covariance.data() : nullptr, parent ? parent->n : 0,
                                        rows, false, block->covariance.data(), scratch_->front);
    block->stamp = cholesky_->Version();
    block->used = queries_;
    BlockPointer& kept = cache_[*it];
    if (kept) bytes_ -= kept->covariance.size() * sizeof(double);
    kept = block;
    bytes_ += block->covariance.size() * sizeof(double);
  }
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
  if (std::exchange(identity_, cholesky_->Identity()) != cholesky_->Identity()) {
    cache_.clear();
    bytes_ = 0;
  }
  if (!scratch_) scratch_ = std::make_unique<internal::RecursionScratch>();
  std::vector<Matrix<B, B>> out;
  out.reserve(variables.size());
  Query query;
  if (method == DiagonalMethod::kCheapest && (variables.size() > 1 || !cache_.empty())) {
    double solve = 0;
    for (const int v : variables) solve += kSolveFlop * Look(cholesky_->Tree().FrontOf(v), query).solve_flops;
    if (variables.size() > kMany) {
      // One pass over everything beats the same paths again and again.
      const double all = internal::AllRecursionFlops(*cholesky_);
      if (all < solve && all < 2 * query.recursion_flops) {
        std::vector<Matrix<B, B>> diagonals;
        internal::ComputeAllDiagonals(*cholesky_, diagonals, *scratch_);
        for (const int v : variables) out.push_back(diagonals[At(v)]);
        return out;
      }
    }
    if (query.recursion_flops < solve) method = DiagonalMethod::kRecursion;
  }
  for (const int v : variables) {
    if (method != DiagonalMethod::kRecursion) {
      out.push_back(JointCovariance(*cholesky_, {v}));
      continue;
    }
    const int id = cholesky_->Tree().FrontOf(v);
    const BlockPointer block = Front(id, query);
    const Eigen::Index at = PivotRow<B>(cholesky_->Tree()[id], v);
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
  internal::ComputeAllDiagonals(*cholesky_, out, *scratch);
  const std::lock_guard<std::mutex> lock(mutex_);
  scratch.swap(scratch_);
  return out;
}

template <int B>
SelectedInverse<B>::SelectedInverse(const BlockCholesky<B>& cholesky, std::size_t cache_bytes)
    : cholesky_(&cholesky), capacity_(cache_bytes) {}

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
