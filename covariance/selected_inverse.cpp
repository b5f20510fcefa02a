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

// Fronts from the variables up to their roots, parents before children.
template <int B>
std::vector<int> PathsTopDown(const BlockCholesky<B>& factor, const std::vector<int>& variables) {
  std::unordered_map<int, int> depth;
  std::vector<int> fronts;
  for (const int v : variables) {
    std::vector<int> path;
    int f = factor.FrontOf(v);
    for (; f >= 0 && depth.count(f) == 0; f = factor.FrontAt(f).parent) path.push_back(f);
    int d = f >= 0 ? depth[f] : -1;
    for (auto it = path.rbegin(); it != path.rend(); ++it) {
      depth[*it] = ++d;
      fronts.push_back(*it);
    }
  }
  std::stable_sort(fronts.begin(), fronts.end(), [&](int a, int b) { return depth[a] < depth[b]; });
  return fronts;
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
Matrix<B, B> SelectedInverse<B>::Diagonal(int variable) const {
  const std::lock_guard<std::mutex> lock(mutex_);
  const int id = factor_->FrontOf(variable);
  const Block& block = Front(id);
  const auto& pivots = factor_->FrontAt(id).pivots;
  const Eigen::Index at = B * (std::find(pivots.begin(), pivots.end(), variable) - pivots.begin());
  return ConstMap(block.covariance.data(), block.n, block.n).block<B, B>(at, at);
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

template <int B>
MatrixX CovarianceBlocks(const BlockCholesky<B>& factor, const std::vector<int>& rows,
                         const std::vector<int>& columns) {
  // X = H^-1 E: forward along the columns' paths, backward along everybody's.
  const Eigen::Index width = B * static_cast<Eigen::Index>(columns.size());
  std::unordered_map<int, MatrixXd> X;  // by variable, B x width; absent is zero
  const auto entry = [&](int v) -> MatrixXd& {
    auto [it, is_new] = X.try_emplace(v);
    if (is_new) it->second = MatrixXd::Zero(B, width);
    return it->second;
  };
  for (size_t c = 0; c < columns.size(); ++c) {
    entry(columns[c]).template middleCols<B>(static_cast<Eigen::Index>(c) * B) += Matrix<B, B>::Identity();
  }
  const auto load = [&](const std::vector<int>& variables) {
    MatrixXd M(B * static_cast<Eigen::Index>(variables.size()), width);
    for (size_t k = 0; k < variables.size(); ++k)
      M.template middleRows<B>(static_cast<Eigen::Index>(k) * B) = entry(variables[k]);
    return M;
  };
  const auto store = [&](const std::vector<int>& variables, const MatrixXd& M) {
    for (size_t k = 0; k < variables.size(); ++k)
      entry(variables[k]) = M.template middleRows<B>(static_cast<Eigen::Index>(k) * B);
  };
  const std::vector<int> forward = PathsTopDown(factor, columns);
  for (auto it = forward.rbegin(); it != forward.rend(); ++it) {
    const auto& front = factor.FrontAt(*it);
    const ConstMap L(front.panel.data(), front.Rows(), front.Columns());
    const Eigen::Index p = front.Columns(), s = front.Rows() - 1 - p;
    MatrixXd z = load(front.pivots);
    L.topRows(p).template triangularView<Eigen::Lower>().solveInPlace(z);
    store(front.pivots, z);
    if (s > 0) store(front.separators, load(front.separators) - L.middleRows(p, s) * z);
  }
  std::vector<int> all(rows);
  all.insert(all.end(), columns.begin(), columns.end());
  for (const int id : PathsTopDown(factor, all)) {
    const auto& front = factor.FrontAt(id);
    const ConstMap L(front.panel.data(), front.Rows(), front.Columns());
    const Eigen::Index p = front.Columns(), s = front.Rows() - 1 - p;
    MatrixXd x = load(front.pivots);
    if (s > 0) x.noalias() -= L.middleRows(p, s).transpose() * load(front.separators);
    L.topRows(p).template triangularView<Eigen::Lower>().transpose().solveInPlace(x);
    store(front.pivots, x);
  }
  return load(rows);
}

template class SelectedInverse<3>;
template class SelectedInverse<6>;
template MatrixX CovarianceBlocks<3>(const BlockCholesky<3>&, const std::vector<int>&, const std::vector<int>&);
template MatrixX CovarianceBlocks<6>(const BlockCholesky<6>&, const std::vector<int>&, const std::vector<int>&);

}  // namespace terse
