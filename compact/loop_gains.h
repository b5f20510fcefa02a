#pragma once
// What the loops of one pose would tell, one after the other.

#include <vector>

#include "terse/compact/information.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {

// What is known of pose n and of the poses that its loops lead to, before any loop: conditioned on one loop after the
// other as they are added, at fixed linearisation points.
template <class Pose>
class LoopGains {
 public:
  static constexpr int B = Pose::kDof;
  using Jacobian = typename Pose::Jacobian;

  // `T_base_n`: odometry from the pose `base`. Ids may repeat.
  LoopGains(const IncrementalMarginals<Pose>& marginals, const IncrementalSolver<Pose>& solver, PoseId base,
            const UncertainPose<Pose>& T_base_n, const std::vector<PoseId>& loops);

  // From loop pose k.
  UncertainPose<Pose> Displacement(int k) const;
  // Leaves these loops, ascending.
  void Keep(const std::vector<int>& loops);

  // The gains of the loops with the measurements' covariance Sigma_y as Algorithm 1 would add them: best first, the
  // rest evaluated again after each; ends with the first one below `least`. A loop's gain only falls as others are
  // added, so those evaluated long ago are looked at again only when they come first. Leaves the loops added.
  std::vector<double> BestFirst(const Jacobian& Sigma_y, double least);

 private:
  double Gain(int k, const Jacobian& Sigma_y) const { return InformationGain<B>(Displacement(k).covariance, Sigma_y); }
  void Add(int k, const Jacobian& Sigma_y);

  MatrixX Sigma_;  // of n, then of the loop poses
  std::vector<Pose> T_loop_n_;
};

extern template class LoopGains<SE2>;
extern template class LoopGains<SE3>;

}  // namespace terse
