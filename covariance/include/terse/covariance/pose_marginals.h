#pragma once
// What can be asked of the covariances of a pose graph; Marginals and IncrementalMarginals answer it.
//
// Perturbation on the right, T Exp(d), d = [rho; phi], metres and radians, body frame, unless another convention is
// asked for. Exact to first order: the results equal blocks of the dense inverse of H at the linearisation points. The
// gauge is fixed as core/gauge.h describes: without priors, covariances are relative to the first pose.
// Concurrent queries are safe. All throw std::invalid_argument for an unknown id.

#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/core/pose_graph.h"
#include "terse/covariance/convention.h"

namespace terse {

template <class Pose>
class PoseMarginals {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;

  virtual ~PoseMarginals() = default;

  Jacobian Marginal(PoseId id, const CovarianceConvention& convention = {}) const;
  // In the order given; ids may repeat.
  std::vector<Jacobian> MarginalsOf(const std::vector<PoseId>& ids, const CovarianceConvention& convention = {}) const;
  // By pose index.
  std::vector<Jacobian> AllMarginals(const CovarianceConvention& convention = {}) const;
  // Cov(d_a, d_b): rows are a's.
  Jacobian Cross(PoseId a, PoseId b, const CovarianceConvention& convention = {}) const;
  // Part of a block column of H^-1: Cov(d_id, d_of) for every id, in the order given.
  std::vector<Jacobian> Column(PoseId of, const std::vector<PoseId>& ids,
                               const CovarianceConvention& convention = {}) const;
  // Of the stacked perturbations of poses, kDof rows each in the order given. Computed as a Gram matrix: symmetric,
  // and positive semidefinite but for the rounding of its entries.
  MatrixX Joint(const std::vector<PoseId>& ids, const CovarianceConvention& convention = {}) const;
  // Of T_a_b = T_world_a^-1 T_world_b. kBody: T_a_b Exp(d); kWorld: Exp(e) T_a_b, that is, in a's frame; kWorldAxes:
  // along a's axes.
  // Computed as a Gram matrix, not as the difference of the poses' own covariances.
  Jacobian Relative(PoseId a, PoseId b, const CovarianceConvention& convention = {}) const;
  // Of the sum of A d over distinct poses, d each one's perturbation (body frame, translation first): whatever depends
  // on several poses, to first order. A Gram matrix too.
  struct Term {
    PoseId id;
    Jacobian A;
  };
  Jacobian Combination(const std::vector<Term>& terms) const;

 protected:
  // All by pose index.
  virtual int IndexOf(PoseId id) const = 0;
  virtual Pose ValueAt(int index) const = 0;
  // Where H is linearised: covariances of several poses belong together there only.
  virtual Pose PointAt(int index) const { return ValueAt(index); }
  virtual const BlockCholesky<B>& CholeskyOfAll() const = 0;
  virtual std::vector<Jacobian> DiagonalBlocks(const std::vector<int>& indices) const = 0;
  virtual std::vector<Jacobian> AllDiagonalBlocks() const = 0;
  virtual std::vector<Jacobian> ColumnBlocks(int of, const std::vector<int>& indices) const;

 private:
  std::vector<int> IndicesOf(const std::vector<PoseId>& ids) const;
};

// Covariance of T_a_b from the joint blocks of a and b (Ila et al. 2017 Eqs. 16-17): body frame, translation
// first.
template <class Pose>
typename Pose::Jacobian RelativeCovariance(const Pose& T_a_b, const typename Pose::Jacobian& Sigma_aa,
                                           const typename Pose::Jacobian& Sigma_ab,
                                           const typename Pose::Jacobian& Sigma_bb);

// The covariance of d in T_from Retract(d) about the d with T_from Retract(d) = T_to, as that of e in T_to Retract(e):
// what is linearised at one value, at another close by. To first order in their difference.
template <class Pose>
typename Pose::Jacobian MoveCovariance(const typename Pose::Jacobian& covariance, const Pose& T_from, const Pose& T_to);

extern template class PoseMarginals<SE2>;
extern template class PoseMarginals<SE3>;

}  // namespace terse
