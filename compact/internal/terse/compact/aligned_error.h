#pragma once
// What covariances say of the position error of a map, however it is laid over the truth.

#include <optional>
#include <vector>

#include "terse/core/linear_factor.h"

namespace terse {

// The expected sum of squared position errors of the poses after the rigid motion that makes it least, square metres:
//   tr(Sigma_pp) - sum_k q_k' Sigma_pp q_k,
// Sigma_pp the positions' part of H^-1 and q_k an orthonormal basis of the rigid motions of the positions. So it does
// not depend on the gauge. H is that of the linear factors, the anchor among them, at T_world_body; variables are the
// pose indices of `map`. Absent if H is singular. A factorisation, a pass of the selected inverse, and substitution
// with as many right-hand sides as a pose has degrees of freedom.
template <class Pose>
std::optional<double> ExpectedAlignedError(const PoseGraph<Pose>& map, const std::vector<Pose>& T_world_body,
                                           std::vector<LinearFactor<Pose::kDof>> factors);

}  // namespace terse
