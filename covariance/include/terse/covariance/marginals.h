#pragma once
// Covariances of a solved pose graph, exact (to first order) at the given values.
//
// Perturbation on the right, T Exp(d), d = [rho; phi], metres and radians, body frame, unless another convention is
// asked for. The gauge is fixed as core/gauge.h describes: without priors, covariances are relative to the first pose.
// The results equal the blocks of the dense inverse of H. Concurrent queries are safe.

#include <memory>
#include <vector>

#include "terse/core/pose_graph.h"
#include "terse/covariance/convention.h"
#include "terse/covariance/selected_inverse.h"

namespace terse {

template <class Pose>
class Marginals {
 public:
  using Jacobian = typename Pose::Jacobian;

  // Factors the graph at the values (by pose index). Throws NumericalError if the system is singular.
  Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body);
  // Takes a factor at hand (variable = pose index), as BatchResult holds it. Throws std::invalid_argument if the sizes
  // differ.
  Marginals(const PoseGraph<Pose>& graph, std::vector<Pose> T_world_body, BlockCholesky<Pose::kDof> factor);

  // All throw std::invalid_argument for an unknown id.
  Jacobian Marginal(PoseId id, const CovarianceConvention& convention = {}) const;
  // By pose index.
  std::vector<Jacobian> AllMarginals(const CovarianceConvention& convention = {}) const;
  // Cov(d_a, d_b): rows are a's.
  Jacobian Cross(PoseId a, PoseId b, const CovarianceConvention& convention = {}) const;
  // Of the stacked perturbations of distinct poses, kDof rows each in the order given.
  MatrixX Joint(const std::vector<PoseId>& ids, const CovarianceConvention& convention = {}) const;
  // Of T_a_b = T_world_a^-1 T_world_b. kBody: T_a_b Exp(d); kWorld: Exp(e) T_a_b.
  Jacobian Relative(PoseId a, PoseId b, const CovarianceConvention& convention = {}) const;

 private:
  const Pose& Value(int index) const { return T_world_body_[static_cast<std::size_t>(index)]; }

  std::vector<PoseId> ids_;
  std::unordered_map<std::int64_t, int> index_;
  std::vector<Pose> T_world_body_;
  int IndexOf(PoseId id) const;
  std::unique_ptr<BlockCholesky<Pose::kDof>> factor_;
  SelectedInverse<Pose::kDof> inverse_;
};

// Covariance of T_a_b from the joint blocks of a and b (Ila et al., IJRR 2017, Eqs. 16-17): body frame, translation
// first.
template <class Pose>
typename Pose::Jacobian RelativeCovariance(const Pose& T_a_b, const typename Pose::Jacobian& Sigma_aa,
                                           const typename Pose::Jacobian& Sigma_ab,
                                           const typename Pose::Jacobian& Sigma_bb);

extern template class Marginals<SE2>;
extern template class Marginals<SE3>;

}  // namespace terse
