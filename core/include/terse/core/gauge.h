#pragma once
// What fixes the gauge of a pose graph.
//
// Relative measurements leave the frame of the map free. A proximal anchor on the first pose fixes it: information on
// that pose's tangent directions with zero residual at whatever value the pose has, so it never enters chi2
// and never biases the optimum. Absolute measurements take its place: any pose prior wholly; position priors for the
// position, while a very weak anchor stays on the rotation, for the turns that they may leave free (about a single
// point, about a straight line).

#include "terse/core/linear_factor.h"

namespace terse {

// 0.1 mm and 0.1 mrad: nothing beside any measurement, and far from the limits of double precision.
inline constexpr double kAnchorInformation = 1e8;
// 30 rad: makes a free turn solvable, with a variance that says that nothing measures it.
inline constexpr double kWeakAnchorInformation = 1e-3;

struct AbsoluteFactors {
  int pose_priors = 0;  // FIXed poses count as such
  int position_priors = 0;
};

template <class Pose>
AbsoluteFactors CountAbsoluteFactors(const PoseGraph<Pose>& graph);

// Information of the anchor on the first pose, per tangent direction; zero where none is needed.
template <class Pose>
Vector<Pose::kDof> AnchorInformation(const AbsoluteFactors& absolute);

// A FIXed pose is held at its value by this prior, which is not counted in chi2.
template <class Pose>
PosePriorFactor<Pose> FixedPosePrior(PoseId id, const Pose& T_world_body);

}  // namespace terse
