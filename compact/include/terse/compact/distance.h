#pragma once
// The distance test: is one pose within sensor range of another, given what is known of their displacement?
//
// Ila et al. 2017 Eqs. 16-20. Displacement of n seen from i: [x y z angle] in 3D, [x y theta] in 2D; metres and
// radians, in i's frame.

#include "terse/compact/uncertain_pose.h"

namespace terse {

template <class Pose>
struct Displacement {
  static constexpr int kSize = Pose::kDim + 1;
  Vector<kSize> mean;
  Matrix<kSize, kSize> covariance;
};

// The angle of a displacement in 3D, in [0, pi]. In 2D it is theta.
enum class AngleMeasure {
  kViewDirection,  // between the view axes: rolling about them changes nothing
  kRotation,       // the length of the rotation vector
};

struct DistanceOptions {
  AngleMeasure angle = AngleMeasure::kViewDirection;
  Vector<3> view_axis = {0, 0, 1};  // body frame, any length but zero; kViewDirection in 3D only

  DistanceOptions() = default;
  DistanceOptions(AngleMeasure measure) : angle(measure) {}              // NOLINT(google-explicit-constructor)
  DistanceOptions(const Vector<3>& direction) : view_axis(direction) {}  // NOLINT(google-explicit-constructor)
};

// [x y z angle] or [x y theta] of T_i_n.
template <class Pose>
Vector<Displacement<Pose>::kSize> DisplacementMean(const Pose& T_i_n, const DistanceOptions& options = {});

// First-order transformation of T_i_n, J Sigma J', except for the angle in 3D. With g its gradient and S the covariance
// of the errors that can change it (phi across the view axis; all of phi),
//   variance = g'Sg + w (L - g'Sg),  w = k / (t^2 + k).
// View direction: t = tan(angle), and from 0 to pi/2 L is S's largest eigenvalue and k = L/2, from pi/2 to pi L is its
// trace and k = 8 L. Rotation: t = 2 tan(angle/2), L the largest eigenvalue, k = L/2. So where the angle is many
// deviations from 0 and pi the variance is that of first order. At 0 (and at pi, for view directions) the gradient has
// no direction and the angle is the length of a vector: there L is taken, and there is no step on the way. The
// probabilities of Ila et al. 2017 Eq. 18 are then never below the true ones by more than docs/algorithms.md says. The
// angle's covariances with the others are (1 - w) times those of first order. The variance never exceeds the trace of
// phi's.
template <class Pose>
Displacement<Pose> ComputeDisplacement(const UncertainPose<Pose>& T_i_n, const DistanceOptions& options = {});

// Ila et al. 2017 Eq. 18 per dimension: the probability that |component| <= range, for a normal component. Angles wrap
// at 2 pi: all of them are within a range of pi or more. The test passes when all are above a threshold.
template <class Pose>
Vector<Displacement<Pose>::kSize> RangeProbabilities(const Displacement<Pose>& displacement,
                                                     const Vector<Displacement<Pose>::kSize>& range);

// Squared Mahalanobis distance from the mean to the nearest displacement within the range: 0 if the mean is within it.
// An angle of range pi or more, or one known to no better than a radian, which may lie anywhere on the circle, does not
// count. `enough`: what is found to be at most this need not be the least.
template <class Pose>
double DistanceToRange(const Displacement<Pose>& displacement, const Vector<Displacement<Pose>::kSize>& range,
                       double enough = 0);

// An upper bound of the angle's RangeProbabilities for a mean in [-pi, pi] and any standard deviation up to `sigma`,
// which may be infinite. Radians.
double AngleProbabilityBound(double mean, double sigma, double range);

// How many standard deviations beyond the range a component's mean can lie while its probability still
// exceeds `probability`; 0 for probabilities of one half and more.
double DeviationsBeyondRange(double probability);

}  // namespace terse
