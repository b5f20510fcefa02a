#pragma once
// A pose graph at its optimum as the choice of links sees it: what is there in any case, and the links it is about, all
// linearised.

#include <vector>

#include "terse/compact/sparsify_options.h"
#include "terse/core/linear_factor.h"
#include "terse/core/pose_graph.h"

namespace terse::internal {

template <class Pose>
struct LinkSystem {
  static constexpr int B = Pose::kDof, D = Pose::kDim;
  // What rigid motions of each connected part do to the positions of its poses, columns orthonormal over the part, rows
  // along the body's axes; zero where absolute measurements say how the part lies.
  using Motions = Eigen::Matrix<double, D, B>;

  int poses = 0;
  std::vector<LinearFactor<B>> fixed;  // edges that are kept in any case, priors, an anchor for each part
  std::vector<LinearFactor<B>> links;
  std::vector<FactorId> ids;      // by link
  std::vector<FactorId> holding;  // edges that hold every pose, ascending: odometry, or a spanning forest
  // Whether a link holds a part together with `fixed` (FixedEdges::kNone): one of a spanning tree, kept at first.
  std::vector<char> in_tree;
  std::vector<Motions> motions;  // by pose
  std::vector<int> roots;        // the first pose of each part
};

// `T_world_body`: the optimum, by pose index. Throws NumericalError if a part has no gauge.
template <class Pose>
LinkSystem<Pose> MakeLinkSystem(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body, FixedEdges fixed);

// The connected parts as graphs of their own, with the ids that poses and factors have.
template <class Pose>
std::vector<PoseGraph<Pose>> SplitIntoParts(const PoseGraph<Pose>& graph);

}  // namespace terse::internal
