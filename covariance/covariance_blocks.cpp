#include "terse/covariance/covariance_blocks.h"

#include <Eigen/Dense>
#include <algorithm>
#include <unordered_map>

namespace terse {
namespace {

using Eigen::MatrixXd;
using std::size_t;

using ConstMap = Eigen::Map<const MatrixXd>;

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

template <int B>
MatrixX JointCovariance(const BlockCholesky<B>& factor, const std::vector<int>& variables) {
  const MatrixX joint = CovarianceBlocks(factor, variables, variables);
  return (joint + joint.transpose()) / 2;
}

#define TERSE_INSTANTIATE(B)                                                                                       \
  template MatrixX CovarianceBlocks<B>(const BlockCholesky<B>&, const std::vector<int>&, const std::vector<int>&); \
  template MatrixX JointCovariance<B>(const BlockCholesky<B>&, const std::vector<int>&);
TERSE_INSTANTIATE(3)
TERSE_INSTANTIATE(6)
#undef TERSE_INSTANTIATE

}  // namespace terse
