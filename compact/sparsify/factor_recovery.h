#pragma once
// The factors that are recovered in place of those of one pose that goes (pose_elimination.h has the mathematics).

#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "terse/compact/pose_removal.h"
#include "terse/compact/sparsify_options.h"

namespace terse::internal {

// All factors between a pose p and its neighbours, and between these, each pair's as one.
template <class Pose>
struct Clique {
  std::vector<Arm<Pose>> arms;                       // p to neighbour
  std::map<std::pair<int, int>, Arm<Pose>> between;  // i to j, i < j
};

// Factors between the neighbours, and the divergence of the exact marginal from them. Absent where the numbers are
// beyond the arithmetic or the means are not mild. O(k^3 B^3) for each sweep over the factors, k neighbours.
template <class Pose>
std::optional<Tree<Pose>> RecoverFactors(const Clique<Pose>& clique, RecoveredFactors recovered, bool conservative);

}  // namespace terse::internal
