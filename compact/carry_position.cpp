#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "compact_pose_slam_parts.h"
#include "terse/core/residual.h"

namespace terse {

template <class Pose>
PositionPriorFactor<Pose> CarryPosition(const PositionPriorFactor<Pose>& prior, PoseId base,
                                        const UncertainPose<Pose>& T_base_pose, const Pose& T_world_base,
                                        bool is_turned) {
  constexpr int D = Pose::kDim;
  using Block = Eigen::Matrix<double, D, D>;
  // Of the measured point in the base's frame: the Jacobian of T_base_pose Exp(d) p_body is that of the factor itself.
  PositionPriorFactor<Pose> in_base = prior;
  const Matrix<D, Pose::kDof> J = EvaluatePosition(in_base, T_base_pose.T_a_b).J_residual_pose;
  const Block chain = J * T_base_pose.covariance * J.transpose();
  Block added;
  if (is_turned) {
    const Block R = T_world_base.Adjoint().template topLeftCorner<D, D>();
    added = R * chain * R.transpose();
  } else {
    const double largest = Eigen::SelfAdjointEigenSolver<Block>(chain, Eigen::EigenvaluesOnly).eigenvalues()[D - 1];
    added = largest * Block::Identity();
  }
  const Block measured = Block(prior.information).llt().solve(Block::Identity());
  const Block information = Block(measured + added).llt().solve(Block::Identity());
  PositionPriorFactor<Pose> out = prior;
  out.pose = base;
  out.p_body = T_base_pose.T_a_b * prior.p_body;
  out.information = (information + information.transpose()) / 2;
  return out;
}

#define TERSE_INSTANTIATE(Pose)                                                                    \
  template PositionPriorFactor<Pose> CarryPosition<Pose>(const PositionPriorFactor<Pose>&, PoseId, \
                                                         const UncertainPose<Pose>&, const Pose&, bool);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
