#include "terse/core/loop_contest.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "terse/core/decompositions.h"
#include "terse/core/definite.h"
#include "terse/core/robust.h"

namespace terse::internal {

template <int B>
Contest<B>::Contest(Eigen::VectorXd residual, Eigen::MatrixXd covariance, std::vector<char> in, double width)
    : n_(std::move(residual)),
      P_(std::move(covariance)),
      in_(std::move(in)),
      k_(in_.size(), width * width),
      width_(width) {}

template <int B>
Contest<B> Contest<B>::Among(const std::vector<std::size_t>& some) const {
  std::vector<Eigen::Index> rows;
  std::vector<char> in;
  for (const std::size_t i : some) {
    for (int b = 0; b < B; ++b) rows.push_back(Row(i) + b);
    in.push_back(in_[i]);
  }
  Contest out(n_(rows), P_(rows, rows), std::move(in), width_);
  for (std::size_t i = 0; i < some.size(); ++i) out.k_[i] = k_[some[i]];
  return out;
}

template <int B>
double Contest<B>::Innovation(std::size_t i) const {
  return MahalanobisSquared<B>(Spread(i), n_.segment<B>(Row(i)));
}

template <int B>
double Contest<B>::Leverage(std::size_t i) const {
  return 1 / std::max(SymmetricEigenvalues<B>(Spread(i))[0], 1e-12);
}

template <int B>
bool Contest<B>::Flip(std::size_t i) {
  const Eigen::LLT<Block> llt(Spread(i));
  if (llt.info() != Eigen::Success) return false;
  const double sign = in_[i] ? 1 : -1;
  const Eigen::Matrix<double, B, 1> n = n_.segment<B>(Row(i));
  const Eigen::Matrix<double, B, Eigen::Dynamic> rows = P_.middleRows<B>(Row(i));
  const Eigen::Matrix<double, Eigen::Dynamic, B> gain = sign * llt.solve(rows).transpose();
  cost_ -= sign * (n.dot(llt.solve(n)) - k_[i]);
  n_.noalias() += gain * n;
  P_.noalias() += gain * rows;
  in_[i] ^= 1;
  return true;
}

template <int B>
double Contest<B>::WorthOfLeaving(const std::vector<std::size_t>& group) const {
  std::vector<Eigen::Index> rows;
  double price = 0;
  for (const std::size_t i : group) {
    for (int b = 0; in_[i] && b < B; ++b) rows.push_back(Row(i) + b);
    if (in_[i]) price += k_[i];
  }
  if (rows.empty()) return 0;
  const auto m = static_cast<Eigen::Index>(rows.size());
  Eigen::MatrixXd S = Eigen::MatrixXd::Identity(m, m);
  S -= P_(rows, rows);
  const Eigen::VectorXd n = n_(rows);
  const Eigen::LLT<Eigen::MatrixXd> llt(S);
  return llt.info() == Eigen::Success ? n.dot(llt.solve(n)) - price : 0;
}

template <int B>
void Contest<B>::Descend(std::size_t first, std::size_t last) {
  for (std::size_t step = 0; step < 4 * Size(); ++step) {
    double best = Least();
    std::size_t flip = last;
    for (std::size_t i = first; i < last; ++i) {
      const double innovation = Innovation(i), decrease = in_[i] ? innovation - k_[i] : k_[i] - innovation;
      if (decrease > best && std::isfinite(decrease)) best = decrease, flip = i;
    }
    if (flip == last || !Flip(flip)) return;
  }
}

template <int B>
void Contest<B>::DescendByGroups(const std::vector<std::vector<std::size_t>>& groups) {
  for (std::size_t step = 0; step < groups.size(); ++step) {
    double best = Least();
    const std::vector<std::size_t>* leaves = nullptr;
    for (const auto& group : groups) {
      const double worth = WorthOfLeaving(group);
      if (worth > best) best = worth, leaves = &group;
    }
    if (leaves == nullptr) return;
    for (const std::size_t i : *leaves) {
      if (in_[i]) Flip(i);
    }
  }
}

template <int B>
bool Contest<B>::Graduate(double gnc_step) {
  for (std::size_t i = 0; i < Size(); ++i) {
    if (in_[i] && !Flip(i)) return false;
  }
  Eigen::VectorXd r = n_, weights(n_.size());
  double largest = 0;
  for (std::size_t i = 0; i < Size(); ++i) largest = std::max(largest, r.segment<B>(Row(i)).squaredNorm());
  bool settled = false;
  double mu = GncStart(largest, width_);
  for (; !settled && std::isfinite(mu); mu *= gnc_step) {
    settled = true;
    for (std::size_t i = 0; i < Size(); ++i) {
      const double w = GncWeight(r.segment<B>(Row(i)).squaredNorm(), width_, mu);
      weights.segment<B>(Row(i)).setConstant(w);
      settled = settled && (w == 0 || w == 1);
    }
    Eigen::MatrixXd M = P_ * weights.asDiagonal();
    M.diagonal().array() += 1;
    r = M.partialPivLu().solve(n_);
  }
  for (std::size_t i = 0; i < Size(); ++i) {
    const bool comes = std::isfinite(mu) ? weights[Row(i)] > 0.5 : r.segment<B>(Row(i)).squaredNorm() <= k_[i];
    if (comes) Flip(i);
  }
  return true;
}

template <int B>
typename Contest<B>::Block Contest<B>::Spread(std::size_t i) const {
  const Block P = P_.block<B, B>(Row(i), Row(i));
  return in_[i] ? Block(Block::Identity() - P) : Block(Block::Identity() + P);
}

template class Contest<3>;
template class Contest<6>;

}  // namespace terse::internal
