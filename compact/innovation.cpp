#include "terse/compact/innovation.h"

#include "terse/core/definite.h"

namespace terse {

template <class Pose>
double InnovationDistance(const UncertainPose<Pose>& predicted, const UncertainPose<Pose>& measured) {
  using Jacobian = typename Pose::Jacobian;
  const Pose difference = measured.T_a_b.Inverse() * predicted.T_a_b;
  const typename Pose::Tangent e = difference.Log();
  const Jacobian A = difference.Inverse().Adjoint();
  const Jacobian sum = predicted.covariance + A * measured.covariance * A.transpose();
  return MahalanobisSquared<Pose::kDof>(sum, e);
}

template double InnovationDistance<SE2>(const UncertainPose<SE2>&, const UncertainPose<SE2>&);
template double InnovationDistance<SE3>(const UncertainPose<SE3>&, const UncertainPose<SE3>&);

}  // namespace terse
