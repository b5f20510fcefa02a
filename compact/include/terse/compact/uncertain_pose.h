#pragma once
// A relative pose with its covariance, and composition: to first order (Smith and Cheeseman, 1986) and to fourth
// (Barfoot and Furgale, IEEE T-RO 2014, with errors on the right instead of the left).

#include "terse/core/pose_graph.h"

namespace terse {

// covariance: of d in T_a_b Exp(d), d normal with mean zero, tangent order [rho; phi], metres and radians.
template <class Pose>
struct UncertainPose {
  Pose T_a_b;
  typename Pose::Jacobian covariance = Pose::Jacobian::Zero();
};

// kFourth adds what products of two covariances contribute: it matters from some tenths of a radian on, and along
// directions in which the first order sees little.
enum class CompositionOrder { kFirst, kFourth };

// T_a_c = T_a_b T_b_c with independent errors. With X = Ad(T_b_c^-1) Sigma_ab Ad(T_b_c^-1)' and Y = Sigma_bc,
// Sigma = X + Y to first order. To fourth, with A_S = E[ad(s) ad(s)] for s ~ N(0, S):
//   Sigma = (I + A_Y/12) X (I + A_Y/12)' + (I + A_X/12) Y (I + A_X/12)' + E[ad(x) Y ad(x)'] / 4.
// Symmetric and positive semidefinite whatever X and Y are; the factored form differs from the series by its sixth
// order only.
template <class Pose>
UncertainPose<Pose> Compose(const UncertainPose<Pose>& ab, const UncertainPose<Pose>& bc,
                            CompositionOrder order = CompositionOrder::kFirst);

// The second moment about T_a_b in the chart of the optimiser: E[e e'] for T_a_b Retract(e) = T_a_b Exp(d). In SE(3)
// this is the covariance itself, in SE(2), where e = [V(phi) rho; phi], the same to first order. For a factor made of
// a long chain: a bent cloud of points reaches farther along the chord than a straight one.
template <class Pose>
typename Pose::Jacobian RetractCovariance(const UncertainPose<Pose>& ab);

// T_b_a, with Sigma = Ad(T_a_b) Sigma Ad(T_a_b)'.
template <class Pose>
UncertainPose<Pose> Invert(const UncertainPose<Pose>& ab);

// A measurement as seen from `first`: T_first_other with the covariance Omega^-1. `first` is one of its two poses.
template <class Pose>
UncertainPose<Pose> SeenFrom(PoseId first, const RelativePoseFactor<Pose>& factor);

}  // namespace terse
