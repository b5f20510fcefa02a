#pragma once
// Everything an update will change, worked out before anything is.

#include <algorithm>
#include <map>
#include <string>
#include <vector>

#include "incremental/linearized_graph.h"

namespace terse::internal {

template <class Pose>
struct UpdatePlan {
  static constexpr int B = Pose::kDof;
  std::map<PoseId, int> new_index;
  std::vector<Pose> new_values;  // in the order of update.poses
  typename BlockCholesky<B>::Changes changes;
  std::vector<Matrix<B, B>> W;  // of update.factors
  std::vector<char> is_loop;    // by update.factors; with a robust kernel, else empty
  std::vector<char> waits;      // the same: of these those that are to be judged, and are not in `changes`
  bool adds_anchor = false;
  bool only_relative = true;  // factors
  MapFrame<Pose> frame;
  std::vector<Pose> moved_points;  // of the poses that were there, if the map moves as a whole; else empty

  bool IsLoop(std::size_t k) const { return !is_loop.empty() && is_loop[k] != 0; }
  std::ptrdiff_t Loops() const { return std::count(is_loop.begin(), is_loop.end(), char{1}); }
  bool Waits(std::size_t k) const { return !waits.empty() && waits[k] != 0; }
  // Besides poses and what brings them in: no priors, nothing removed or moved.
  bool BringsLoopsOnly() const { return only_relative && changes.removed.empty() && moved_points.empty(); }
  int IndexOf(PoseId id, const PoseGraph<Pose>& graph) const {
    const auto it = new_index.find(id);
    return it != new_index.end() ? it->second : graph.IndexOf(id);
  }
};

// Checks the update, gives its new poses values, finds the frame and linearises what comes. Throws
// std::invalid_argument as IncrementalSolver::Update says. `width`: of the robust kernel, if there is one.
template <class Pose>
UpdatePlan<Pose> PlanUpdate(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map,
                            const IncrementalOptions& options, double width);

// What the anchor will hold. Where it lets go, the map goes to where the measurements say before it does: the values of
// new poses move with it, and everything that stays is linearised where it comes to lie.
template <class Pose>
void PlanFrame(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, const IncrementalOptions& options,
               UpdatePlan<Pose>& plan);

// What absolute measurements so far leave undetermined, in words (gauge.h); "" if nothing, or if there are none.
template <class Pose>
std::string DescribeUndetermined(const LinearizedGraph<Pose>& map, const IncrementalOptions& options);

}  // namespace terse::internal
