#include "terse/compact/innovation.h"

#include <Eigen/Cholesky>

namespace terse {

template <class Pose>
double InnovationDistance(const UncertainPose<Pose>& predicted, const UncertainPose<Pose>& measured) {
  using Jacobian = typename Pose::Jacobian;
  const Pose difference = measured.T_a_b.Inverse() * predicted.T_a_b;
  const typename Pose::Tangent e = Pose().Local(difference);
  const Jacobian J = Pose::LocalJacobian(e), A = difference.Inverse().Adjoint();
  const Jacobian sum = predicted.covariance + A * measured.covariance * A.transpose();
  // |L^-1 J^-1 e|: what stretches the angle near pi cancels.
  const typename Pose::Tangent unstretched = J.partialPivLu().solve(e);
  return sum.llt().matrixL().solve(unstretched).squaredNorm();
}

template double InnovationDistance<SE2>(const UncertainPose<SE2>&, const UncertainPose<SE2>&);
template double InnovationDistance<SE3>(const UncertainPose<SE3>&, const UncertainPose<SE3>&);

}  // namespace terse
