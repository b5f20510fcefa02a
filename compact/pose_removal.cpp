#include "terse/compact/pose_removal.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>

#include "terse/compact/log_determinant.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/decompositions.h"
#include "terse/core/definite.h"
#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse::internal {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// The spanning tree of least total weight, by Kruskal's algorithm, that holds `must`.
std::vector<std::pair<int, int>> SpanningTree(int nodes, std::vector<std::tuple<double, int, int>> weighted,
                                              std::optional<std::pair<int, int>> must) {
  std::vector<int> part(At(nodes));
  std::iota(part.begin(), part.end(), 0);
  std::vector<std::pair<int, int>> tree;
  const auto join = [&](int i, int j) {
    const int from = part[At(j)], to = part[At(i)];
    if (from == to) return;
    std::replace(part.begin(), part.end(), from, to);
    tree.emplace_back(i, j);
  };
  if (must) join(must->first, must->second);
  std::sort(weighted.begin(), weighted.end());
  for (const auto& [weight, i, j] : weighted) join(i, j);
  return tree;
}

// The joint distribution of the displacements from the first neighbour to the others, and of others made of them.
template <class Pose>
class Star {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;

  explicit Star(const std::vector<Arm<Pose>>& arms) : arms_(arms) {
    for (const Arm<Pose>& arm : arms) {
      R_.push_back(arm.Covariance());
      mean_.push_back(arm.Mean());
    }
  }
  int Size() const { return static_cast<int>(arms_.size()); }
  Pose Estimate(int i, int j) const { return arms_[At(i)].Estimate().Inverse() * arms_[At(j)].Estimate(); }
  // d_ij = d_j - Ad(E_j_i) d_i, so with other ends that it shares an error with:
  Jacobian Covariance(const std::pair<int, int>& e, const std::pair<int, int>& f) const {
    const auto [i, j] = e;
    const auto [k, l] = f;
    const Jacobian A = Estimate(j, i).Adjoint(), C = Estimate(l, k).Adjoint();
    Jacobian sum = Jacobian::Zero();
    if (j == l) sum += R_[At(j)];
    if (j == k) sum -= R_[At(j)] * C.transpose();
    if (i == l) sum -= A * R_[At(i)];
    if (i == k) sum += A * R_[At(i)] * C.transpose();
    return sum;
  }
  typename Pose::Tangent Mean(const std::pair<int, int>& e) const {
    return mean_[At(e.second)] - Estimate(e.second, e.first).Adjoint() * mean_[At(e.first)];
  }
  MatrixXd Joint(const std::vector<std::pair<int, int>>& edges) const {
    const int n = static_cast<int>(edges.size());
    MatrixXd Sigma(B * n, B * n);
    for (int e = 0; e < n; ++e) {
      for (int f = 0; f < n; ++f) Sigma.block<B, B>(B * e, B * f) = Covariance(edges[At(e)], edges[At(f)]);
    }
    return (Sigma + Sigma.transpose()) / 2;
  }

 private:
  const std::vector<Arm<Pose>>& arms_;
  std::vector<Jacobian> R_;
  std::vector<typename Pose::Tangent> mean_;
};

}  // namespace

// With the residual r and its Jacobian J at E the mean is -J^-1 r. In both charts r = -J(-mean) mean has the J of
// -mean.
template <class Pose>
RelativePoseFactor<Pose> FactorOf(const Pose& E, const typename Pose::Tangent& mean,
                                  const typename Pose::Jacobian& information) {
  using Jacobian = typename Pose::Jacobian;
  const typename Pose::Tangent r = -(Pose::LocalJacobian(-mean) * mean);
  const Jacobian J_inverse = InverseOf<Pose::kDof>(Pose::LocalJacobian(r));
  const Jacobian of_residual = J_inverse.transpose() * information * J_inverse;
  RelativePoseFactor<Pose> factor;
  factor.T_from_to = E * Pose().Retract(r).Inverse();
  factor.information = (of_residual + of_residual.transpose()) / 2;
  return factor;
}

template <class Pose>
bool IsMild(const typename Pose::Tangent& mean, const typename Pose::Jacobian& information) {
  static const double most = ChiSquareQuantile(0.9999, Pose::kDof);
  constexpr double kMostRadians = 0.2;
  return mean.template tail<Pose::kDof - Pose::kDim>().norm() < kMostRadians && mean.dot(information * mean) < most;
}

template <class Pose>
void Arm<Pose>::Add(PoseId p, const RelativePoseFactor<Pose>& factor) {
  Tangent r;
  Jacobian J;
  if (factor.from == p) {
    r = factor.T_from_to.Local(E_p_k_);
    J = Pose::LocalJacobian(r);
  } else {
    r = factor.T_from_to.Local(E_p_k_.Inverse());
    J = -Pose::LocalJacobian(r) * E_p_k_.Adjoint();
  }
  const Jacobian JtOmega = J.transpose() * factor.information;
  information_ += JtOmega * J;
  vector_ -= JtOmega * r;
}

template <class Pose>
typename Pose::Jacobian Arm<Pose>::Covariance() const {
  const Jacobian covariance = InverseOfDefinite<Pose::kDof>(information_);
  return (covariance + covariance.transpose()) / 2;
}

template <class Pose>
typename Pose::Tangent Arm<Pose>::Mean() const {
  return SolveDefinite<Pose::kDof>(information_, vector_);
}

template <class Pose>
RelativePoseFactor<Pose> Arm<Pose>::AsFactor(PoseId p, PoseId k) const {
  RelativePoseFactor<Pose> factor = FactorOf<Pose>(E_p_k_, Mean(), information_);
  factor.from = p;
  factor.to = k;
  return factor;
}

// In the coordinates of the tree's edges, Sigma exact: the tree knows the blocks on its diagonal. L^-1 Sigma L^-T, with
// L of these blocks, has ones there, and its largest eigenvalue is the scale that makes the tree conservative. The
// gradient of the map is the same if the tree's information times its mean is that of Sigma.
template <class Pose>
std::optional<Tree<Pose>> RecoverTree(const std::vector<Arm<Pose>>& arms, std::optional<std::pair<int, int>> must) {
  constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;
  Tree<Pose> out;
  const Star<Pose> star(arms);
  if (star.Size() < 2) return out;
  std::vector<std::tuple<double, int, int>> weighted;
  for (int i = 0; i < star.Size(); ++i) {
    for (int j = i + 1; j < star.Size(); ++j) {
      const double weight = LogDeterminant(star.Covariance({i, j}, {i, j}));
      if (!std::isfinite(weight)) return std::nullopt;
      weighted.emplace_back(weight, i, j);
    }
  }
  const auto edges = SpanningTree(star.Size(), weighted, must);
  const int n = static_cast<int>(edges.size());
  const MatrixXd Sigma = star.Joint(edges);
  const Eigen::LLT<MatrixXd> exact(Sigma);
  if (exact.info() != Eigen::Success) return std::nullopt;
  VectorXd mean(B * n);
  MatrixXd L = MatrixXd::Zero(B * n, B * n);
  for (int e = 0; e < n; ++e) {
    mean.segment<B>(B * e) = star.Mean(edges[At(e)]);
    L.block<B, B>(B * e, B * e) = LowerCholesky<B>(Sigma.block<B, B>(B * e, B * e));
  }
  if (n > 1) {
    const auto lower = L.triangularView<Eigen::Lower>();
    const MatrixXd left = lower.solve(Sigma);
    const MatrixXd share = lower.solve(left.transpose());
    out.scale = std::max(1.0, SymmetricEigenvalues<Eigen::Dynamic>((share + share.transpose()) / 2)[B * n - 1]);
    const double log_exact = exact.matrixLLT().diagonal().array().log().sum();
    out.loss = L.diagonal().array().log().sum() + B * n * std::log(out.scale) / 2 - log_exact;
    out.loss = std::max(out.loss, 0.0);
    mean = out.scale * (L * (L.transpose() * exact.solve(mean)));
  }
  if (!std::isfinite(out.loss) || !mean.allFinite()) return std::nullopt;
  for (int e = 0; e < n; ++e) {
    const auto [i, j] = edges[At(e)];
    const Jacobian covariance = out.scale * Sigma.block<B, B>(B * e, B * e);
    const Jacobian information = InverseOfDefinite<B>(covariance);
    if (n > 1 && !IsMild<Pose>(mean.segment<B>(B * e), information)) return std::nullopt;
    const auto factor = FactorOf<Pose>(star.Estimate(i, j), mean.segment<B>(B * e), information);
    out.factors.push_back({i, j, factor.T_from_to, factor.information});
  }
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                         \
  template class Arm<Pose>;                                                                             \
  template RelativePoseFactor<Pose> FactorOf(const Pose&, const Pose::Tangent&, const Pose::Jacobian&); \
  template bool IsMild<Pose>(const Pose::Tangent&, const Pose::Jacobian&);                              \
  template std::optional<Tree<Pose>> RecoverTree(const std::vector<Arm<Pose>>&, std::optional<std::pair<int, int>>);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
