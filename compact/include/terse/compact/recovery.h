#pragma once
// How compact pose SLAM gives dropped poses back.

#include "terse/core/pose_graph.h"

namespace terse {

// How dropped poses come back. kV0: as estimated when they were dropped. kV1 (Ila et al. 2017 Eq. 24): chained to the
// kept pose before them. kV2 (Ila et al. 2017 Eqs. 25-26): that chain's misfit at the next kept pose spread over it by
// its covariance; behind the last kept pose as kV1, but where odometry went on from a dropped pose whose own chain has
// ended, from that one as recovered.
enum class Recovery { kV0, kV1, kV2 };

template <class Pose>
struct RecoveredPose {
  PoseId id;
  bool kept = true;
  Pose T_world_body;
};

}  // namespace terse
