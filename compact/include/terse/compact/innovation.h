#pragma once
// Does a measured relative pose agree with what is known of it?

#include "terse/compact/uncertain_pose.h"

namespace terse {

// Squared Mahalanobis distance e' S^-1 e of a measurement Z of T_a_b from the prediction T, with independent errors:
//   e = Local(Z^-1 T),   S = J (Sigma_T + A Sigma_Z A') J',
// J = dLocal at e, A = Ad(T^-1 Z). Chi-square with Pose::kDof degrees of freedom for a correct measurement, to first
// order. (S leaves outliers open; a wrong link has a high gain.)
template <class Pose>
double InnovationDistance(const UncertainPose<Pose>& predicted, const UncertainPose<Pose>& measured);

}  // namespace terse
