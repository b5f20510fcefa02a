#pragma once
// Poses of a graph at its optimum that go, and the factors that are recovered in place of theirs.
//
// A pose p goes by exact marginalisation of the factors between it and its neighbours and of those between the
// neighbours themselves. What is left of them, N(mu, Lambda_t^-1) over the neighbours' displacements, is dense. In its
// place come relative factors e with full information between some pairs of neighbours, Lambda_r = sum J_e' Omega_e
// J_e: those closest to it in Kullback-Leibler divergence (nonlinear factor recovery: Mazuran, Burgard, Tipaldi, IJRR
// 2016),
//   D(target || recovered) = (tr(Lambda_r Sigma_t) - log det(Lambda_r Sigma_t) - n) / 2, nats,
// found by descent factor by factor (Vallve, Sola, Andrade-Cetto, 2018), each step exact under Omega_e >= 0. It starts
// from the Chow-Liu tree of p's own factors, as generic linear constraints have it (Carlevaris-Bianco, Kaess, Eustice,
// T-RO 2014), next to the edges that are there, and so is never worse. The means are such that the gradient of the
// graph, and with it the optimum, stays.
//
// Everything is linear about the estimates: T_a_b = E_a_b Exp(d). One elimination takes O(k^3 B^3) for each sweep over
// the factors, k neighbours and B = Pose::kDof.

#include <functional>
#include <vector>

#include "terse/compact/sparsify_options.h"
#include "terse/core/pose_graph.h"

namespace terse::internal {

struct EliminationOptions {
  RecoveredFactors recovered = RecoveredFactors::kSubgraph;
  // Each elimination's information is scaled so that it never exceeds the exact marginal's, Lambda_r <= Lambda_t.
  bool conservative = false;
  int least_kept = 0;        // poses at which it ends
  int most_neighbours = 10;  // a pose with more stays
  // They stay, and besides poses that are fixed or have a prior, and of every connected part the first and the last.
  std::vector<PoseId> stay;
  // False: stop. Told how many are eliminated before each elimination, and while the first plans are made.
  std::function<bool(int eliminated)> progress;
};

template <class Pose>
struct EliminatedPose {
  PoseId pose;
  double loss = 0;                 // nats, of this elimination alone: the divergence above
  std::vector<PoseId> neighbours;  // when it went
};

// Where a new factor comes from.
template <class Pose>
struct RecoveredEdge {
  FactorId factor;
  // The eliminated poses on the ways that it stands for: the one that made it, and those behind the factors that joined
  // that one and the two ends. Ascending.
  std::vector<PoseId> through;
};

template <class Pose>
struct Elimination {
  // The poses that are kept, in their order and with their values. Factors that no elimination touched have their ids,
  // new ones have ids above all in the graph that came.
  PoseGraph<Pose> graph;
  std::vector<EliminatedPose<Pose>> eliminated;  // in order
  std::vector<RecoveredEdge<Pose>> recovered;    // ascending
  double loss = 0;                               // nats, the sum
  bool stopped = false;
};

// Poses go one after the other, each time the one that loses least, of equal ones the one with the fewest neighbours,
// until so few are left or none may go: one whose factors disagree with the estimates by more than their covariances
// explain stays, as nothing is linear there. `graph`: every pose has its value, the graph's optimum. Throws
// std::invalid_argument if one has none, or one of `stay` is unknown.
template <class Pose>
Elimination<Pose> EliminatePoses(const PoseGraph<Pose>& graph, const EliminationOptions& options);

}  // namespace terse::internal
