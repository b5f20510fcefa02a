#pragma once
// The distance test: is one pose within sensor range of another, given what is known of their displacement?
//
// Ila et al., IJRR 2017, Eqs. 16-20. Displacement of n seen from i: [x y z angle] in 3D, where the angle is between the
// view axes (so rolling about the view axis changes nothing), [x y theta] in 2D; metres and radians, in i's frame.

#include "terse/compact/uncertain_pose.h"

namespace terse {

template <class Pose>
struct Displacement {
  static constexpr int kSize = Pose::kDim + 1;
  Vector<kSize> mean;
  Matrix<kSize, kSize> covariance;
};

// [x y z angle] or [x y theta] of T_i_n. `view_axis` as below.
template <class Pose>
Vector<Displacement<Pose>::kSize> DisplacementMean(const Pose& T_i_n, const Vector<3>& view_axis = {0, 0, 1});

// First-order transformation of T_i_n. `view_axis` (body frame, any length) is used in 3D only. At angles 0 and pi,
// where its gradient has no direction, the angle takes the direction of largest variance: never too small.
template <class Pose>
Displacement<Pose> ComputeDisplacement(const UncertainPose<Pose>& T_i_n, const Vector<3>& view_axis = {0, 0, 1});

// Eq. 18 per dimension: the probability that |component| <= range, for a normal component. Angles wrap at
// 2 pi: all of them are within a range of pi or more. The test passes when all are above a threshold.
template <class Pose>
Vector<Displacement<Pose>::kSize> RangeProbabilities(const Displacement<Pose>& displacement,
                                                     const Vector<Displacement<Pose>::kSize>& range);

// An upper bound of the angle's RangeProbabilities for a mean in [-pi, pi] and any standard deviation up to `sigma`,
// which may be infinite. Radians.
double AngleProbabilityBound(double mean, double sigma, double range);

// How many standard deviations beyond the range a component's mean can lie while its probability still
// exceeds `probability`; 0 for probabilities of one half and more.
double DeviationsBeyondRange(double probability);

}  // namespace terse
