#pragma once
// The chordal cost of SE-Sync as a problem on poses: to a critical point from values close by.

#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// A relative measurement with isotropic weights.
template <class Pose>
struct ChordalTerm {
  int from, to;  // pose indices
  Matrix<Pose::kDim, Pose::kDim> R;
  Vector<Pose::kDim> t;
  double kappa, tau;
};

template <class Pose>
std::vector<ChordalTerm<Pose>> ChordalTerms(const PoseGraph<Pose>& graph);

template <class Pose>
double ChordalCost(const std::vector<ChordalTerm<Pose>>& terms, const std::vector<Pose>& T_world_body);

// Gauss-Newton with shortened steps, the first pose where it is. Returns the iterations.
template <class Pose>
int DescendChordally(const std::vector<ChordalTerm<Pose>>& terms, int max_iterations, int threads,
                     std::vector<Pose>& T_world_body);

Matrix<2, 2> RotationOf(const SE2& T);
Matrix<3, 3> RotationOf(const SE3& T);

}  // namespace terse::internal
