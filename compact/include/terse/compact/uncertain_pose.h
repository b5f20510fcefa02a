#pragma once
// A relative pose with its covariance, and composition (Smith and Cheeseman: first order).

#include "terse/core/pose_graph.h"

namespace terse {

// covariance: of d in T_a_b Exp(d), tangent order [rho; phi], metres and radians.
template <class Pose>
struct UncertainPose {
  Pose T_a_b;
  typename Pose::Jacobian covariance = Pose::Jacobian::Zero();
};

// T_a_c = T_a_b T_b_c with independent errors: Sigma = Ad(T_b_c^-1) Sigma_ab Ad(T_b_c^-1)' + Sigma_bc.
template <class Pose>
UncertainPose<Pose> Compose(const UncertainPose<Pose>& ab, const UncertainPose<Pose>& bc);

// T_b_a, with Sigma = Ad(T_a_b) Sigma Ad(T_a_b)'.
template <class Pose>
UncertainPose<Pose> Invert(const UncertainPose<Pose>& ab);

// A measurement as seen from `first`: T_first_other with the covariance Omega^-1. `first` is one of its two poses.
template <class Pose>
UncertainPose<Pose> SeenFrom(PoseId first, const RelativePoseFactor<Pose>& factor);

}  // namespace terse
