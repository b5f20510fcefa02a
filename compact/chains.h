#pragma once
// Chains of odometry: as factors between kept poses, and split again.

#include <optional>

#include "terse/compact/uncertain_pose.h"

namespace terse::internal {

// As a factor of the optimiser.
template <class Pose>
RelativePoseFactor<Pose> Measurement(PoseId from, PoseId to, const UncertainPose<Pose>& T_from_to,
                                     CompositionOrder order);

// The chain from `middle` on, of one from `start` through `middle`. Covariances of a chain add up
// (Sigma_bc = Ad(T_cb) Sigma_ab Ad(T_cb)' + Sigma_bc), so it follows by subtraction from what is remembered of the
// whole; nothing of single odometry edges is stored. Absent where nothing but rounding is left.
template <class Pose>
std::optional<UncertainPose<Pose>> Behind(const UncertainPose<Pose>& T_start_middle,
                                          const UncertainPose<Pose>& T_start_end);

}  // namespace terse::internal
