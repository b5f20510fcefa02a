#include "terse/compact/uncertain_pose.h"

#include <Eigen/Cholesky>
#include <stdexcept>

namespace terse {

template <class Pose>
UncertainPose<Pose> Compose(const UncertainPose<Pose>& ab, const UncertainPose<Pose>& bc) {
  const typename Pose::Jacobian A = bc.T_a_b.Inverse().Adjoint();
  const typename Pose::Jacobian covariance = A * ab.covariance * A.transpose() + bc.covariance;
  return {ab.T_a_b * bc.T_a_b, (covariance + covariance.transpose()) / 2};
}

template <class Pose>
UncertainPose<Pose> Invert(const UncertainPose<Pose>& ab) {
  const typename Pose::Jacobian A = ab.T_a_b.Adjoint();
  const typename Pose::Jacobian covariance = A * ab.covariance * A.transpose();
  return {ab.T_a_b.Inverse(), (covariance + covariance.transpose()) / 2};
}

template <class Pose>
UncertainPose<Pose> SeenFrom(PoseId first, const RelativePoseFactor<Pose>& factor) {
  const typename Pose::Jacobian covariance = factor.information.llt().solve(Pose::Jacobian::Identity());
  const UncertainPose<Pose> measured{factor.T_from_to, (covariance + covariance.transpose()) / 2};
  if (first == factor.from) return measured;
  if (first == factor.to) return Invert(measured);
  throw std::invalid_argument("the factor does not touch pose " + std::to_string(first.value));
}

#define TERSE_INSTANTIATE(Pose)                                                                       \
  template UncertainPose<Pose> Compose<Pose>(const UncertainPose<Pose>&, const UncertainPose<Pose>&); \
  template UncertainPose<Pose> Invert<Pose>(const UncertainPose<Pose>&);                              \
  template UncertainPose<Pose> SeenFrom<Pose>(PoseId, const RelativePoseFactor<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
