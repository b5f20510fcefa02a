#pragma once
// Everything an update will change, worked out before anything is.

#include <map>

#include "terse/core/incremental_solver.h"

namespace terse {

template <class Pose>
struct IncrementalSolver<Pose>::Plan {
  std::map<PoseId, int> new_index;
  std::vector<Pose> new_values;  // in the order of update.poses
  typename BlockCholesky<B>::Changes changes;
  std::vector<Matrix<B, B>> W;  // of update.factors
  std::vector<char> is_loop;    // by update.factors; with a robust kernel, else empty. Loops are not in `changes`
  bool adds_anchor = false;
  AbsoluteFactors absolute;
  Gauge<Pose> gauge;
  int gauge_found_at = 0;
  std::vector<Pose> moved_points;  // of the poses that were there, if the map moves as a whole; else empty

  bool IsLoop(std::size_t k) const { return !is_loop.empty() && is_loop[k] != 0; }
  int IndexOf(PoseId id, const PoseGraph<Pose>& graph) const {
    const auto it = new_index.find(id);
    return it != new_index.end() ? it->second : graph.IndexOf(id);
  }
};

}  // namespace terse
