#pragma once
// Where all poses seen are in the present map, and how well that is known (Ila et al. 2017 Eqs. 24-26, and beyond them
// the covariance of dropped poses).
//
// With T_base_pose = Exp(l) M, M the composed odometry, the error l of a chain grows by independent steps from pose to
// pose, l_k = l_{k-1} + a step: Cov(l_j, l_k) = P of the last pose that both chains lead through, P = Ad(M) C Ad(M)'
// the covariance gathered up to there. A kept pose n at the end of the chain gives l_n = e away, e the misfit in
// T_base_n = Exp(e) M_n. Then
//   l_k = K e + c,   K = P_k P_n^-1,   c = l_k - K l_n independent of e:
// K e is kV2, and the pose's error is that of its base and of n, and c. The odometry of the chain is a factor of the
// map already, so what is known of base and n is all that is known of e.

#include <vector>

#include "kept_map.h"
#include "pose_history.h"
#include "terse/compact/recovery.h"
#include "terse/covariance/convention.h"

namespace terse::internal {

// A view: what it looks at stays as it is meanwhile.
template <class Pose>
class PoseRecovery {
 public:
  using Jacobian = typename Pose::Jacobian;

  PoseRecovery(const PoseHistory<Pose>& history, const KeptMap<Pose>& map) : history_(history), map_(map) {}

  // As CompactPoseSlam documents them.
  Pose Estimate(PoseId id, Recovery recovery) const;
  std::vector<RecoveredPose<Pose>> Trajectory(Recovery recovery) const;
  Jacobian Covariance(PoseId id, const CovarianceConvention& convention) const;
  Jacobian RelativeCovariance(PoseId a, PoseId b, const CovarianceConvention& convention) const;

 private:
  struct Bridge;
  struct Error;
  Bridge BridgeOf(PoseId dropped, int ended) const;
  Pose Recover(PoseId dropped, int ended) const;
  Error ErrorOf(PoseId id) const;
  Jacobian CovarianceOf(const Error& error) const;
  Jacobian ChainCovariance(const Error& error) const;

  const PoseHistory<Pose>& history_;
  const KeptMap<Pose>& map_;
};

}  // namespace terse::internal
