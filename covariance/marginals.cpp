#include "terse/covariance/marginals.h"

#include <stdexcept>

#include "terse/core/batch_solver.h"

namespace terse {

using std::size_t;

template <class Pose>
Marginals<Pose>::Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body)
    : Marginals(graph, T_world_body, FactorAt(graph, T_world_body)) {}

template <class Pose>
Marginals<Pose>::Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body,
                           BlockCholesky<Pose::kDof> factor)
    : T_world_body_(std::move(T_world_body)),
      factor_(std::make_unique<BlockCholesky<Pose::kDof>>(std::move(factor))),
      inverse_(*factor_) {
  if (T_world_body_.size() != graph.Poses().size() || factor_->Variables() != static_cast<int>(T_world_body_.size())) {
    throw std::invalid_argument("the graph, its values and the factor differ in size");
  }
  for (const auto& node : graph.Poses()) {
    index_[node.id.value] = static_cast<int>(ids_.size());
    ids_.push_back(node.id);
  }
}

template <class Pose>
int Marginals<Pose>::IndexOf(PoseId id) const {
  const auto it = index_.find(id.value);
  if (it == index_.end()) throw std::invalid_argument("pose " + std::to_string(id.value) + " is not in the graph");
  return it->second;
}

template <class Pose>
typename Pose::Jacobian Marginals<Pose>::Marginal(PoseId id, const CovarianceConvention& convention) const {
  const int i = IndexOf(id);
  return ConvertCovariance<Pose>(inverse_.Diagonal(i), Value(i), convention);
}

template <class Pose>
std::vector<typename Pose::Jacobian> Marginals<Pose>::AllMarginals(const CovarianceConvention& convention) const {
  std::vector<Jacobian> out = inverse_.AllDiagonals();
  for (size_t i = 0; i < out.size(); ++i) out[i] = ConvertCovariance<Pose>(out[i], T_world_body_[i], convention);
  return out;
}

template <class Pose>
typename Pose::Jacobian Marginals<Pose>::Cross(PoseId a, PoseId b, const CovarianceConvention& convention) const {
  const int i = IndexOf(a), j = IndexOf(b);
  return ConvertCrossCovariance<Pose>(CovarianceBlocks(*factor_, {i}, {j}), Value(i), Value(j), convention);
}

template <class Pose>
MatrixX Marginals<Pose>::Joint(const std::vector<PoseId>& ids, const CovarianceConvention& convention) const {
  constexpr int B = Pose::kDof;
  std::vector<int> indices;
  for (const PoseId id : ids) indices.push_back(IndexOf(id));
  MatrixX joint = CovarianceBlocks(*factor_, indices, indices);
  for (size_t r = 0; r < ids.size(); ++r) {
    for (size_t c = 0; c < ids.size(); ++c) {
      auto block = joint.block<B, B>(static_cast<Eigen::Index>(r) * B, static_cast<Eigen::Index>(c) * B);
      block = ConvertCrossCovariance<Pose>(block, Value(indices[r]), Value(indices[c]), convention);
    }
  }
  // Rounding leaves the two triangles a few bits apart.
  return (joint + joint.transpose()) / 2;
}

template <class Pose>
typename Pose::Jacobian Marginals<Pose>::Relative(PoseId a, PoseId b, const CovarianceConvention& convention) const {
  constexpr int B = Pose::kDof;
  const int i = IndexOf(a), j = IndexOf(b);
  if (i == j) throw std::invalid_argument("a relative pose needs two distinct poses");
  const MatrixX joint = CovarianceBlocks(*factor_, {i, j}, {i, j});
  const Pose T_a_b = Value(i).Inverse() * Value(j);
  const Jacobian covariance =
      RelativeCovariance<Pose>(T_a_b, joint.template topLeftCorner<B, B>(), joint.template topRightCorner<B, B>(),
                               joint.template bottomRightCorner<B, B>());
  return ConvertCovariance<Pose>(covariance, T_a_b, convention);
}

template <class Pose>
typename Pose::Jacobian RelativeCovariance(const Pose& T_a_b, const typename Pose::Jacobian& Sigma_aa,
                                           const typename Pose::Jacobian& Sigma_ab,
                                           const typename Pose::Jacobian& Sigma_bb) {
  // T_a_b <- T_a_b Exp(d_b - Ad(T_a_b^-1) d_a).
  using Jacobian = typename Pose::Jacobian;
  const Jacobian A = T_a_b.Inverse().Adjoint();
  const Jacobian cross = A * Sigma_ab;
  const Jacobian out = A * Sigma_aa * A.transpose() + Sigma_bb - cross - cross.transpose();
  return (out + out.transpose()) / 2;
}

template class Marginals<SE2>;
template class Marginals<SE3>;
template SE2::Jacobian RelativeCovariance<SE2>(const SE2&, const SE2::Jacobian&, const SE2::Jacobian&,
                                               const SE2::Jacobian&);
template SE3::Jacobian RelativeCovariance<SE3>(const SE3&, const SE3::Jacobian&, const SE3::Jacobian&,
                                               const SE3::Jacobian&);

}  // namespace terse
