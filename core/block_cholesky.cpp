#include "terse/core/block_cholesky.h"

#include <algorithm>
#include <stdexcept>

#include "version.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

}  // namespace

template <int B>
void BlockCholesky<B>::SetFactor(int slot, const LinearFactor<B>& factor) {
  LinearFactor<B>& old = factors_.at(At(slot));
  if (old.first != factor.first || old.second != factor.second)
    throw std::invalid_argument("a factor may not change its variables");
  old = factor;
}

template <int B>
bool BlockCholesky<B>::Refactor(const std::vector<double>& damping) {
  version_ = internal::NextVersion();
  std::vector<int> order = TopDown();
  for (auto it = order.rbegin(); it != order.rend(); ++it) {
    if (FactorFront(fronts_[At(*it)], {}, damping) >= 0) return false;
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
std::vector<int> BlockCholesky<B>::Solve(double threshold) {
  moved_.resize(front_of_.size(), 0);
  std::vector<int> changed, stack(roots_);
  Eigen::VectorXd x;
  while (!stack.empty()) {
    Front& front = fronts_[At(stack.back())];
    stack.pop_back();
    const auto is_moved = [&](int v) { return moved_[At(v)] != 0; };
    if (!front.fresh && std::none_of(front.separators.begin(), front.separators.end(), is_moved)) {
      // Nothing changed here; a refactored front has refactored ancestors, so none is below.
      continue;
    }
    front.fresh = false;
    stack.insert(stack.end(), front.children.begin(), front.children.end());
    const int rows = front.Rows(), p = front.Columns();
    const Eigen::Map<const Eigen::MatrixXd> L(front.panel.data(), rows, p);
    x = L.row(rows - 1).transpose();
    int row = p;
    for (const int v : front.separators) {
      const Eigen::Map<const Eigen::Matrix<double, B, 1>> xs(solution_.data() + At(v) * B);
      x.noalias() -= L.middleRows<B>(row).transpose() * xs;
      row += B;
    }
    L.topRows(p).template triangularView<Eigen::Lower>().transpose().solveInPlace(x);
    for (size_t k = 0; k < front.pivots.size(); ++k) {
      const int v = front.pivots[k];
      Eigen::Map<Eigen::Matrix<double, B, 1>> old(solution_.data() + At(v) * B);
      const auto value = x.segment<B>(static_cast<Eigen::Index>(k) * B);
      if ((value - old).cwiseAbs().maxCoeff() <= threshold) continue;
      old = value;
      moved_[At(v)] = 1;
      changed.push_back(v);
    }
  }
  for (const int v : changed) moved_[At(v)] = 0;
  return changed;
}

template <int B>
void BlockCholesky<B>::SetSolution(int variable, const Vector<B>& d) {
  std::copy_n(d.data(), B, solution_.begin() + static_cast<long>(variable) * B);
}

template <int B>
double BlockCholesky<B>::LogDeterminant() const {
  double sum = 0;
  for (const int f : roots_) sum += fronts_[At(f)].subtree_log_det;
  return sum;
}

template <int B>
double BlockCholesky<B>::NewtonDecrement() const {
  double sum = 0;
  for (const int f : roots_) sum += fronts_[At(f)].subtree_y2;
  return sum;
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
  std::vector<double> d(front_of_.size() * B, 0.0);
  const auto add = [&](int v, const Matrix<B, B>& A) {
    Eigen::Map<Vector<B>>(d.data() + At(v) * B) += A.colwise().squaredNorm().transpose();
  };
  for (const auto& f : factors_) {
    if (f.first < 0) continue;
    add(f.first, f.A_first);
    if (f.second >= 0) add(f.second, f.A_second);
  }
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
