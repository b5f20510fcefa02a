#pragma once
// What the residuals of a pose graph would be if its information were right: drawn at random, from the factor.
//
// At the optimum the residuals of a linear least-squares problem are those of the noise less what the poses took up of
// it: r = (I - A H^-1 A') n for whitened noise n. Draws of n give draws of r with exactly the variances and
// correlations that the graph's leverages imply, at the price of one substitution each.

#include <cstdint>
#include <vector>

#include "terse/core/block_cholesky.h"
#include "terse/core/pose_graph.h"
#include "terse/covariance/information_scale.h"

namespace terse::internal {

// Relative factors of a graph with weights. The information is that of a factor of weight one.
template <class Pose>
struct ProbeTerm {
  int first = -1, second = -1;  // pose indices
  RelativePoseFactor<Pose> factor;
  double weight = 1;
};

// Mean squares per scalar of the residual's translation and rotation, each over the variance that the information
// states: one would be right where nothing is taken up.
struct BlockSquares {
  double translation = 0, rotation = 0;
};

template <class Pose>
BlockSquares SquaresOf(const typename Pose::Tangent& residual, const typename Pose::Jacobian& information);

// So many of the loops agree with information that is not far too certain; the others are wrong.
inline constexpr double kManyAgree = 0.3;

// Share of the loops of the graph's beginning that agree with the odometry between their ends as both are stated.
template <class Pose>
double ShareOfAgreeingLoops(const PoseGraph<Pose>& graph, const EstimateOptions& options);

// `factor`: of the weighted terms, linearised at the values. By term, then by draw. Same seed, same draws.
template <class Pose>
std::vector<std::vector<BlockSquares>> DrawResiduals(const std::vector<ProbeTerm<Pose>>& terms,
                                                     const std::vector<Pose>& T_world_body,
                                                     const BlockCholesky<Pose::kDof>& factor, int draws,
                                                     std::uint64_t seed);

}  // namespace terse::internal
