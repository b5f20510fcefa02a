#pragma once
// What the rigid motions of a whole map do to the positions of its poses: what an alignment takes out of their errors.

#include <vector>

#include "terse/covariance/pose_marginals.h"

namespace terse::internal {

template <class Pose>
class RigidMotions {
 public:
  static constexpr int B = Pose::kDof, D = Pose::kDim, kTurns = B - D;
  using Block = Eigen::Matrix<double, D, B>;

  RigidMotions() = default;
  // Of the poses' positions.
  explicit RigidMotions(const std::vector<Pose>& T_world_body);

  // From a pose's own perturbation to that of its position in the world.
  Block ToWorld(std::size_t pose, const typename Pose::Jacobian& body) const {
    return R_world_body_[pose] * body.template topRows<D>();
  }
  // The sum over k of q_k' d, a row for each of an orthonormal basis q_k of the motions and d the positions'
  // perturbations, as a combination of the poses' own.
  std::vector<typename PoseMarginals<Pose>::Term> Terms(const std::vector<PoseId>& ids) const;
  // Displacements of the positions, by pose, without what a rigid motion explains.
  void TakeOut(std::vector<Block>& displacements) const;

 private:
  std::vector<Eigen::Matrix<double, D, D>> R_world_body_;
  std::vector<Eigen::Matrix<double, D, kTurns>> turns_;  // about the middle, orthonormal over all positions
};

extern template class RigidMotions<SE2>;
extern template class RigidMotions<SE3>;

}  // namespace terse::internal
