#pragma once
// Substitution along paths of a block factor's tree: for single factors, what one that is not in it would see, and for
// some variables, their share of the Gauss-Newton step.

#include <Eigen/Dense>
#include <cstddef>
#include <map>
#include <unordered_set>
#include <vector>

#include "terse/core/block_cholesky.h"

namespace terse::internal {

// Forward substitution L z = A' of a factor's Jacobian: z by front, in the order of the front's pivots.
template <int B>
using Columns = std::map<int, Eigen::Matrix<double, Eigen::Dynamic, B>>;

template <int B>
std::vector<int> PathOf(const BlockCholesky<B>& factor, int variable) {
  std::vector<int> path;
  for (int f = factor.FrontOf(variable); f >= 0; f = factor.FrontAt(f).parent) path.push_back(f);
  return path;
}

// The fronts of both paths, children first.
template <int B>
std::vector<int> PathsOf(const BlockCholesky<B>& factor, int first, int second) {
  std::vector<int> a = PathOf(factor, first), b = PathOf(factor, second), common;
  while (!a.empty() && !b.empty() && a.back() == b.back()) {
    common.push_back(a.back());
    a.pop_back();
    b.pop_back();
  }
  a.insert(a.end(), b.begin(), b.end());
  a.insert(a.end(), common.rbegin(), common.rend());
  return a;
}

// The fronts that hold the variables, and all their ancestors; parents first.
template <int B>
std::vector<int> AncestorClosure(const BlockCholesky<B>& factor, const std::vector<int>& variables) {
  std::vector<int> order, path;
  std::unordered_set<int> seen;
  for (const int v : variables) {
    for (int f = factor.FrontOf(v); f >= 0 && seen.insert(f).second; f = factor.FrontAt(f).parent) path.push_back(f);
    order.insert(order.end(), path.rbegin(), path.rend());
    path.clear();
  }
  return order;
}

// Back-substitution on these fronts: their share of the full Gauss-Newton step (Arablouei 2026, Eq. 15, which holds for
// sets that are closed under ancestors). Returns the variables.
template <int B>
std::vector<int> SolveOn(BlockCholesky<B>& factor, const std::vector<int>& fronts) {
  std::vector<int> variables;
  Eigen::VectorXd x;
  for (const int f : fronts) {
    const auto& front = factor.FrontAt(f);
    const int rows = front.Rows(), p = front.Columns();
    const Eigen::Map<const Eigen::MatrixXd> L(front.panel.data(), rows, p);
    x = L.row(rows - 1).transpose();
    int row = p;
    for (const int v : front.separators) {
      const Eigen::Map<const Vector<B>> xs(factor.Solution().data() + static_cast<std::size_t>(v) * B);
      x.noalias() -= L.template middleRows<B>(row).transpose() * xs;
      row += B;
    }
    L.topRows(p).template triangularView<Eigen::Lower>().transpose().solveInPlace(x);
    row = 0;
    for (const int v : front.pivots) {
      factor.SetSolution(v, x.segment<B>(row));
      variables.push_back(v);
      row += B;
    }
  }
  return variables;
}

template <int B>
Columns<B> SolveForward(const BlockCholesky<B>& factor, const LinearFactor<B>& f) {
  std::map<int, Matrix<B, B>> rhs;
  rhs[f.first] = f.A_first.transpose();
  rhs[f.second] = f.A_second.transpose();
  Columns<B> out;
  Eigen::Matrix<double, Eigen::Dynamic, B> below;
  for (const int id : PathsOf(factor, f.first, f.second)) {
    const auto& front = factor.FrontAt(id);
    const int rows = front.Rows(), p = front.Columns();
    const Eigen::Map<const Eigen::MatrixXd> L(front.panel.data(), rows, p);
    auto& z = out[id];
    z.setZero(p, B);
    int row = 0;
    for (const int v : front.pivots) {
      const auto it = rhs.find(v);
      if (it != rhs.end()) z.template middleRows<B>(row) = it->second;
      row += B;
    }
    L.topRows(p).template triangularView<Eigen::Lower>().solveInPlace(z);
    below.noalias() = L.middleRows(p, rows - 1 - p) * z;
    row = 0;
    for (const int v : front.separators) {
      const auto it = rhs.try_emplace(v, Matrix<B, B>::Zero()).first;
      it->second -= below.template middleRows<B>(row);
      row += B;
    }
  }
  return out;
}

template <int B>
Matrix<B, B> Gram(const Columns<B>& a, const Columns<B>& b) {
  Matrix<B, B> sum = Matrix<B, B>::Zero();
  for (const auto& [front, z] : a) {
    const auto it = b.find(front);
    if (it != b.end()) sum.noalias() += z.transpose() * it->second;
  }
  return sum;
}

// L' x = z for all variables, z by front.
template <int B>
std::vector<double> SolveBackward(const BlockCholesky<B>& factor, const Columns<B>& z, const Vector<B>& q) {
  std::vector<double> x(static_cast<std::size_t>(factor.Variables()) * B, 0.0);
  std::vector<int> stack = factor.Roots();
  Eigen::VectorXd xs, xp;
  while (!stack.empty()) {
    const int id = stack.back();
    stack.pop_back();
    const auto& front = factor.FrontAt(id);
    const int rows = front.Rows(), p = front.Columns();
    const Eigen::Map<const Eigen::MatrixXd> L(front.panel.data(), rows, p);
    xs.resize(rows - 1 - p);
    int row = 0;
    for (const int v : front.separators) {
      xs.template segment<B>(row) = Eigen::Map<const Vector<B>>(x.data() + static_cast<std::size_t>(v) * B);
      row += B;
    }
    const auto it = z.find(id);
    if (it == z.end() && xs.isZero(0)) continue;  // all below stays
    xp = it != z.end() ? Eigen::VectorXd(it->second * q) : Eigen::VectorXd::Zero(p);
    xp.noalias() -= L.middleRows(p, rows - 1 - p).transpose() * xs;
    L.topRows(p).template triangularView<Eigen::Lower>().transpose().solveInPlace(xp);
    row = 0;
    for (const int v : front.pivots) {
      Eigen::Map<Vector<B>>(x.data() + static_cast<std::size_t>(v) * B) = xp.template segment<B>(row);
      row += B;
    }
    stack.insert(stack.end(), front.children.begin(), front.children.end());
  }
  return x;
}

}  // namespace terse::internal
