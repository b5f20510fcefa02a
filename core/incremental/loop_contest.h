#pragma once
// Which of a few loops are in, by truncated least squares on the linearised system.

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "terse/core/robust.h"

namespace terse::internal {

// Loops given everything but themselves: residuals n and their covariance P, B rows each; k = width^2.
class Contest {
 public:
  Contest(Eigen::VectorXd residual, Eigen::MatrixXd covariance, int B, double width)
      : n_(std::move(residual)), P_(std::move(covariance)), B_(B), width_(width) {}

  // What the loops add to the minimum of truncated least squares when these are in.
  double Cost(const std::vector<char>& chosen) const {
    std::vector<Eigen::Index> rows;
    double cost = 0;
    for (std::size_t i = 0; i < chosen.size(); ++i) {
      if (!chosen[i]) cost += width_ * width_;
      for (int b = 0; chosen[i] && b < B_; ++b) rows.push_back(Row(i) + b);
    }
    const auto m = static_cast<Eigen::Index>(rows.size());
    if (m == 0) return cost;
    Eigen::MatrixXd S = Eigen::MatrixXd::Identity(m, m);
    Eigen::VectorXd n(m);
    for (Eigen::Index j = 0; j < m; ++j) {
      n[j] = n_[rows[static_cast<std::size_t>(j)]];
      for (Eigen::Index i = j; i < m; ++i)
        S(i, j) += P_(rows[static_cast<std::size_t>(i)], rows[static_cast<std::size_t>(j)]);
    }
    const Eigen::LLT<Eigen::MatrixXd> llt(S);
    return llt.info() == Eigen::Success ? cost + n.dot(llt.solve(n)) : std::numeric_limits<double>::infinity();
  }

  // Graduated non-convexity from the residuals that the loops have when none is in.
  std::vector<char> Graduate(double step) const {
    const std::size_t count = static_cast<std::size_t>(n_.size() / B_);
    Eigen::VectorXd r = n_, weights(n_.size());
    double largest = 0;
    for (std::size_t i = 0; i < count; ++i) largest = std::max(largest, r.segment(Row(i), B_).squaredNorm());
    bool settled = false;
    double mu = GncStart(largest, width_);
    for (; !settled && std::isfinite(mu); mu *= step) {
      settled = true;
      for (std::size_t i = 0; i < count; ++i) {
        const double w = GncWeight(r.segment(Row(i), B_).squaredNorm(), width_, mu);
        weights.segment(Row(i), B_).setConstant(w);
        settled = settled && (w == 0 || w == 1);
      }
      Eigen::MatrixXd M = P_ * weights.asDiagonal();
      M.diagonal().array() += 1;
      r = M.partialPivLu().solve(n_);
    }
    std::vector<char> chosen(count);
    for (std::size_t i = 0; i < count; ++i) {
      chosen[i] = std::isfinite(mu) ? weights[Row(i)] > 0.5 : r.segment(Row(i), B_).squaredNorm() <= width_ * width_;
    }
    return chosen;
  }

  // Single flips while they lower the cost, the best first.
  double Descend(std::vector<char>& chosen) const {
    double cost = Cost(chosen);
    for (;;) {
      double best = cost - 1e-9 * width_ * width_;
      std::size_t flip = chosen.size();
      for (std::size_t i = 0; i < chosen.size(); ++i) {
        chosen[i] ^= 1;
        const double other = Cost(chosen);
        chosen[i] ^= 1;
        if (other < best) best = other, flip = i;
      }
      if (flip == chosen.size()) return cost;
      chosen[flip] ^= 1;
      cost = best;
    }
  }

 private:
  Eigen::Index Row(std::size_t i) const { return static_cast<Eigen::Index>(i) * B_; }
  Eigen::VectorXd n_;
  Eigen::MatrixXd P_;
  int B_;
  double width_;
};

}  // namespace terse::internal
