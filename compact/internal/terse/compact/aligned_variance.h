#pragma once
// How well the positions of a map are known as a whole, however it is laid over the truth: A-optimality without the
// gauge. The measure of what a measurement tells that is about error; nats (information.h) are about volumes, and count
// what is known of an angle of a far end of the map as much as that of its middle.
//
// With Sigma_pp the positions' part of H^-1 and q_k an orthonormal basis of what rigid motions do to the positions, the
// expected sum of squared position errors after the best alignment is, to first order,
//   V = tr(P Sigma_pp P),   P = I - sum_k q_k q_k',
// and a measurement of the displacement d of two poses with the covariance R takes
//   tr((Sigma_d + R)^-1 C' P C),   C = Cov(p, d),
// from it: two block columns of H^-1. All at the linearisation points.

#include <cstdint>
#include <vector>

#include "terse/compact/rigid_motions.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse::internal {

template <class Pose>
class AlignedVariance {
 public:
  using Jacobian = typename Pose::Jacobian;

  // Both outlive this.
  AlignedVariance(const IncrementalSolver<Pose>& solver, const IncrementalMarginals<Pose>& marginals)
      : solver_(solver), marginals_(marginals) {}

  // V, square metres. O(kept poses) and as many substitutions as a pose has degrees of freedom, once per change.
  double Total();
  // The share of V that a measurement of T_a_b takes, covariance in b's frame. O(kept poses). 0 if a is b.
  double ShareTold(PoseId a, PoseId b, const Jacobian& Sigma_a_b);
  // The solver is another.
  void Forget() { ids_.clear(); }

 private:
  void Refresh();

  const IncrementalSolver<Pose>& solver_;
  const IncrementalMarginals<Pose>& marginals_;
  // Of the factor's version_. Nothing of it is stored: it is worked out again to the same bits.
  std::uint64_t version_ = 0;
  std::vector<PoseId> ids_;
  RigidMotions<Pose> motions_;
  double total_ = -1;  // V; negative until it is asked for
};

}  // namespace terse::internal
