#pragma once
// How much terrain a trajectory has been in.

#include <vector>

#include "terse/lie/se3.h"

namespace terse {

// By each pose, square metres: the number of cubes of side `cell_m` entered so far, times the area of one of their
// sides. The cubes' grid is centred in the trajectory's box, so that terrain flatter than a cube is in one layer of
// them. Levels of a building, a cube apart or more, count one by one. Empty unless cell_m > 0 and all is finite.
std::vector<double> ExploredArea(const std::vector<SE3>& T_world_body, double cell_m);

}  // namespace terse
