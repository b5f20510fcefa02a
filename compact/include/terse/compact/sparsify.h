#pragma once
// A finished pose graph made small: which links to keep, which poses to drop, what replaces these.
//
//     SparsifyOptions options;
//     options.links = SparsifyBudget{0.2};
//     const Sparsified<SE3> small = Sparsify(graph, options);
//     WriteG2o(small.graph, "small.g2o");
//
// 1. The graph is brought to its optimum, and linearised there.
// 2. Links are chosen greedily by SparsifyCriterion, each in the presence of those chosen before, and exchanged at the
//    end where another one is worth more. For positions the links that matter most to all poses come first, whatever
//    they say about places that nobody else passes by.
// 3. The graph of what is kept is brought to its own optimum.
// 4. Poses go where that loses least, each by exact marginalisation; the factors that replace its own are those closest
//    to the marginal in Kullback-Leibler divergence (nonlinear factor recovery: Mazuran, Burgard, Tipaldi, IJRR 2016).
//    Odometry that is only composed loses nothing.
// Priors and FIXed poses are kept; connected parts are treated side by side, with one budget. Links that are the same
// twice are two links. Deterministic.

#include <vector>

#include "terse/compact/compact_map.h"
#include "terse/compact/sparsify_options.h"
#include "terse/core/pose_graph.h"

namespace terse {

// A link that the budget was for.
struct ConsideredLink {
  FactorId id;  // in the graph that came
  PoseId from, to;
  bool kept = false;
  // What it told at its choice, or would tell beside those chosen: nats by kInformation; by kPosition the square metres
  // that it takes from the sum of squared position errors, to about a fifth. Else 0.
  double worth = 0;
};

// What a number of links is worth.
struct SparsifyPoint {
  int links = 0;
  // Root mean square over all poses, after the best rigid alignment, metres: what the information says.
  double expected_error = 0;
};

// A dropped pose and what its removal lost, nats: the divergence of the exact marginal from what replaced it.
struct DroppedPose {
  PoseId id;
  double loss = 0;
  int neighbours = 0;
};

template <class Pose>
struct Sparsified {
  PoseGraph<Pose> graph;                 // kept poses and factors with the original ids, at the optimum
  CompactMap<Pose> map;                  // the same and the dropped poses, with where everything comes from
  std::vector<Pose> T_world_body_whole;  // the optimum of the whole graph, by its pose index
  std::vector<Pose> T_world_body;        // all poses, dropped ones too, where the kept links have them
  std::vector<ConsideredLink> links;     // in the order of the graph's factors
  std::vector<SparsifyPoint> course;     // ascending links; by kInformation only the first and the last
  std::vector<DroppedPose> dropped;      // in the order in which they went
  int links_at_least = 0;                // with FixedEdges::kNone as many of the kept links as hold the poses
  int exchanges = 0;                     // of links at the end that changed the choice for the better
  double expected_error_whole = 0, expected_error = 0;  // metres, as in SparsifyPoint, of all links and of those kept
  double log_det_lost = 0;                              // of the information, nats, by the links left out
  double loss = 0;                                      // nats, by the poses dropped: the sum over them
  // nats: of the exact marginal of the kept poses, with the kept links, from what `graph` says of them.
  double divergence = 0;
  double chi2_whole = 0, chi2 = 0;  // at the optimum of the whole graph, and of `graph`
  struct Seconds {
    double optimum = 0, links = 0, poses = 0;
  } seconds;
};

// Throws std::invalid_argument for options out of their domain, an empty graph, or fewer poses than can be kept;
// NumericalError if the graph has no optimum; StoppedError when options.progress says false.
template <class Pose>
Sparsified<Pose> Sparsify(const PoseGraph<Pose>& graph, const SparsifyOptions& options);

}  // namespace terse
