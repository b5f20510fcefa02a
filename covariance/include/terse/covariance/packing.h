#pragma once
// How coarse a packed graph (WritePacked, terse/core/graph_file.h) may be.

#include "terse/core/graph_file.h"

namespace terse {

// `share` of the standard deviations that the residuals show, or of the stated ones if these are smaller
// (EstimateInformationScale): unit matrices and the like say far more than the measurements deviate. Where residuals
// tell nothing, as in a tree or in pieces, a hundredth of that. Throws std::invalid_argument unless 0 < share <= 1.
template <class Pose>
PackedPrecision ChoosePacking(const PoseGraph<Pose>& graph, double share = PackedPrecision().translation);

}  // namespace terse
