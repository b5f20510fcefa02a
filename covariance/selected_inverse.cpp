#include "terse/covariance/selected_inverse.h"

#include <Eigen/Dense>
#include <algorithm>
#include <unordered_map>

namespace terse {
namespace {

using Eigen::MatrixXd;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

using ConstMap = Eigen::Map<const MatrixXd>;

// Rows of a front's variables, counted in variables: pivots, then separators.
template <int B>
std::unordered_map<int, int> RowsOf(const typename BlockCholesky<B>::Front& front) {
  std::unordered_map<int, int> rows;
  int row = 0;
  for (const int v : front.pivots) rows[v] = row++;
  for (const int v : front.separators) rows[v] = row++;
  return rows;
}

}  // namespace

template <int B>
typename SelectedInverse<B>::Block SelectedInverse<B>::ComputeFront(int id, const Block* parent) const {
  const auto& front = factor_->FrontAt(id);
  const Eigen::Index p = front.Columns(), rows = front.Rows(), s = rows - 1 - p;
  const ConstMap panel(front.panel.data(), rows, p);
  const auto L_PP = panel.topRows(p);
  Block block;
  block.n = static_cast<int>(p + s);
  block.covariance.resize(At(block.n) * At(block.n));
  Eigen::Map<MatrixXd> Sigma(block.covariance.data(), p + s, p + s);
  MatrixXd L_inverse = MatrixXd::Identity(p, p);
  L_PP.template triangularView<Eigen::Lower>().solveInPlace(L_inverse);
  auto Sigma_PP = Sigma.topLeftCorner(p, p);
  Sigma_PP.noalias() = L_inverse.template triangularView<Eigen::Lower>().transpose() * L_inverse;
  if (s == 0) return block;
  const auto& up = factor_->FrontAt(front.parent);
  const auto row_in_parent = RowsOf<B>(up);
  const ConstMap Sigma_parent(parent->covariance.data(), parent->n, parent->n);
  auto Sigma_SS = Sigma.bottomRightCorner(s, s);
  for (size_t j = 0; j < front.separators.size(); ++j) {
    const int cj = row_in_parent.at(front.separators[j]) * B;
    for (size_t i = 0; i < front.separators.size(); ++i) {
      const int ci = row_in_parent.at(front.separators[i]) * B;
      Sigma_SS.block<B, B>(static_cast<Eigen::Index>(i) * B, static_cast<Eigen::Index>(j) * B) =
          Sigma_parent.block<B, B>(ci, cj);
    }
  }
  const MatrixXd K = panel.middleRows(p, s) * L_inverse.template triangularView<Eigen::Lower>();
  auto Sigma_SP = Sigma.bottomLeftCorner(s, p);
  Sigma_SP.noalias() = -Sigma_SS * K;
  Sigma_PP.noalias() -= K.transpose() * Sigma_SP;
  Sigma.topRightCorner(p, s) = Sigma_SP.transpose();
  return block;
}

template <int B>
const typename SelectedInverse<B>::Block& SelectedInverse<B>::Front(int front) const {
  if (version_ != factor_->Version()) {
    cache_.clear();
    version_ = factor_->Version();
  }
  std::vector<int> path;
  for (int f = front; f >= 0 && cache_.count(f) == 0; f = factor_->FrontAt(f).parent) path.push_back(f);
  for (auto it = path.rbegin(); it != path.rend(); ++it) {
    const int up = factor_->FrontAt(*it).parent;
    cache_[*it] = ComputeFront(*it, up < 0 ? nullptr : &cache_.at(up));
  }
  return cache_.at(front);
}

template <int B>
std::vector<Matrix<B, B>> SelectedInverse<B>::Diagonals(const std::vector<int>& variables) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  std::vector<Matrix<B, B>> out;
  out.reserve(variables.size());
  for (const int v : variables) {
    const int id = factor_->FrontOf(v);
    const Block& block = Front(id);
    const auto& pivots = factor_->FrontAt(id).pivots;
    const Eigen::Index at = B * (std::find(pivots.begin(), pivots.end(), v) - pivots.begin());
    out.push_back(ConstMap(block.covariance.data(), block.n, block.n).block<B, B>(at, at));
  }
  return out;
}

template <int B>
std::vector<Matrix<B, B>> SelectedInverse<B>::AllDiagonals() const {
  std::vector<Matrix<B, B>> out(At(factor_->Variables()));
  struct Frame {
    Block block;
    size_t next_child = 0;
    int front = -1;
  };
  const auto visit = [&](int id, const Block* parent) {
    Frame frame;
    frame.front = id;
    frame.block = ComputeFront(id, parent);
    const ConstMap Sigma(frame.block.covariance.data(), frame.block.n, frame.block.n);
    Eigen::Index at = 0;
    for (const int v : factor_->FrontAt(id).pivots) {
      out[At(v)] = Sigma.block<B, B>(at, at);
      at += B;
    }
    return frame;
  };
  for (const int root : factor_->Roots()) {
    std::vector<Frame> stack;
    stack.push_back(visit(root, nullptr));
    while (!stack.empty()) {
      Frame& top = stack.back();
      const auto& children = factor_->FrontAt(top.front).children;
      if (top.next_child == children.size()) {
        stack.pop_back();
      } else {
        const int child = children[top.next_child++];
        stack.push_back(visit(child, &top.block));
      }
    }
  }
  return out;
}

template class SelectedInverse<3>;
template class SelectedInverse<6>;

}  // namespace terse
