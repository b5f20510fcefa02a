#pragma once
// Does a measured relative pose agree with what is known of it?

#include "terse/compact/uncertain_pose.h"

namespace terse {

// Squared Mahalanobis distance e' S^-1 e of a measurement Z of T_a_b from the prediction T, with independent errors:
//   e = Log(Z^-1 T),   S = Sigma_T + A Sigma_Z A',
// A = Ad(T^-1 Z). (With J = J_r^-1(e) the covariance of e is J S J', and J e = e: J cancels.) In exponential
// coordinates what a long chain knows is normal also where its heading is off by tens of degrees (Long et al., RSS
// 2012); in the optimiser's chart of SE(2) true links would be refused there. Chi-square with Pose::kDof degrees of
// freedom for a correct measurement, to first order. (S leaves outliers open; a wrong link has a high gain.)
template <class Pose>
double InnovationDistance(const UncertainPose<Pose>& predicted, const UncertainPose<Pose>& measured);

}  // namespace terse
