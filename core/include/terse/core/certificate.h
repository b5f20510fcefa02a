#pragma once
// Is an optimum the global one? A certificate, which needs no search.
//
//     const Certificate certificate = Certify(graph, SolveBatch(graph).T_world_body);
//     if (certificate.is_global) ...
//
// It is one of the chordal problem: rotations R and positions p that minimise, over all relative measurements (R~, t~)
// from i to j,
//     sum kappa |R_j - R_i R~|^2 + tau |p_j - p_i - R_i t~|^2,
// kappa and tau being those of isotropic noise with the stated variances (Rosen, Carlone, Bandeira, Leonard: SE-Sync,
// IJRR 2019, Eqs. 12 and 13). Its cost is that of the graph to first order where noise is isotropic and residuals are
// small; priors, and correlations within a measurement, have no part in it.
//
// 1. From the estimate the chordal problem goes down to its own critical point close by (Gauss-Newton).
// 2. At a critical point every rotation has a symmetric multiplier Lambda_i. With M the matrix of the quadratic cost
//    and S = M - Diag(Lambda), positions eliminated, any other solution costs at least
//    sum tr Lambda_i + D n min(0, lambda), lambda the smallest eigenvalue of S (ibid., Theorem 2 and Eq. 26). If S has
//    no negative one, nothing is lower.
// 3. lambda by shifted and inverted Lanczos iteration (Spectra) on a sparse Cholesky factor (Eigen).
//
// Where the certificate fails the optimum may be a local one, or the relaxation is not tight (much noise, wrong loops);
// the gap bounds what could be gained.

#include <string>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

struct CertifyOptions {
  double most_gap = 1e-5;  // relative, of an optimum that counts as global
  int max_iterations = 200;
  int threads = 1;
};

struct Certificate {
  bool is_global = false;
  double smallest_eigenvalue = 0;  // of S; unit of kappa
  double cost = 0;                 // of the chordal problem at its critical point; about chi2
  double bound = 0;                // no solution of it costs less
  double gap = 0;                  // (cost - bound) / cost, 0 or more; over a millionth per scalar if cost is less
  // From the estimate to the critical point, the first pose where it is: what is certified is that one.
  double largest_turn_rad = 0, largest_shift_m = 0;
  int iterations = 0;
  bool has_absolute = false;  // there are priors or FIXed poses, which have no part in it
};

// Throws std::invalid_argument if there is not one value per pose, or the graph is empty or not connected by relative
// measurements; NumericalError if the eigenvalue is not found.
template <class Pose>
Certificate Certify(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body,
                    const CertifyOptions& options = {});

}  // namespace terse
