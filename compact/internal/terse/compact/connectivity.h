#pragma once
// Which k of m candidate edges make a weighted graph well connected: those with which its algebraic connectivity, or
// Fiedler value, the second smallest eigenvalue lambda_2 of the Laplacian L, is large. As MAC does (Doherty, Rosen and
// Leonard, Spectral Measurement Sparsification for Pose-Graph SLAM, 2022):
//   relaxation: maximise lambda_2(L(w)), L(w) = L_fixed + sum w_e L_e, over 0 <= w <= 1, sum w = k. It is concave, and
//     kappa_e (v_a - v_b)^2 is a supergradient, with kappa_e the weight of e = (a, b) and v the Fiedler vector.
//   Frank and Wolfe: steps of 2 / (t + 2) towards the k candidates with the largest gradient, at most 20.
//   bound: lambda_2(L(w)) <= v' L(w) v for any unit v with mean zero, so the largest v' L(w) v, fixed edges and those
//   k,
//     bounds every choice, even if v is but nearly a Fiedler vector.
//   rounding: the k largest weights, or Madow's systematic sampling with w as the probabilities of inclusion.
//
// Fiedler pairs are found by a preconditioned subspace method (Davidson's) with Rayleigh-Ritz steps, orthogonal to the
// constant vector. The preconditioner is the sparse Cholesky factor of the Laplacian without one node, which makes it
// inverse iteration in a Krylov space. If the factor would be too dense, as that of random graphs, it is that of the
// heaviest spanning tree and the heaviest of the other edges. Every call gives the same bits for the same arguments.

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace terse::internal {

// Nodes count from 0 and differ, the weight is positive and finite. Several edges may join the same nodes.
struct WeightedEdge {
  int a, b;
  double weight;
};

enum class Rounding {
  kNearest,  // the largest weights of the relaxation, the first of equal ones
  kMadow,    // at random
  kBest,     // whichever of both has the higher Fiedler value
};

struct ConnectivityChoice {
  std::vector<char> chosen;  // by candidate, exactly k ones
  double fiedler = 0;        // of what is fixed and chosen
  double upper_bound = 0;    // no choice of so many has more
  int iterations = 0;        // steps of Frank and Wolfe
};

// Throws std::invalid_argument if `fixed` does not connect all nodes, if k is not in [0, m], or for an edge as above is
// not. The Fiedler value of a single node is 0.
ConnectivityChoice ChooseByConnectivity(int nodes, const std::vector<WeightedEdge>& fixed,
                                        const std::vector<WeightedEdge>& candidates, int k, Rounding rounding,
                                        std::uint64_t seed = 1);

struct FiedlerPair {
  double value;
  Eigen::VectorXd vector;  // of unit norm and mean zero; its first entry that is not zero is positive
};

// Value 0 and a vector that is constant on what hangs together with node 0 and on the rest if the graph is not
// connected; of a single node 0 and a zero vector. `start`: some vectors, nodes x any, in whose span the vector nearly
// is.
FiedlerPair FindFiedlerPair(int nodes, const std::vector<WeightedEdge>& edges, const Eigen::MatrixXd* start = nullptr);

}  // namespace terse::internal
