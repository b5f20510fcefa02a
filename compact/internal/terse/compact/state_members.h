#pragma once
// How state_file.h stores the types of compact pose SLAM: for the .cpp of what holds some of them.

#include "terse/compact/compact_pose_slam.h"
#include "terse/core/state_members.h"

namespace terse {

template <class Archive, class Pose>
void Serialize(Archive& archive, UncertainPose<Pose>& pose) {
  auto& [T_a_b, covariance] = pose;
  archive(T_a_b, covariance);
}

template <class Archive>
void Serialize(Archive& archive, DistanceOptions& options) {
  auto& [angle, view_axis] = options;
  archive(angle, view_axis);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, CompactOptions<Pose>& options) {
  auto& [strategy, thresholds, budget, min_variance_drop, retire_share, plausible_quantile, max_registrations,
         failed_neighbourhood, distance, composition, innovation_quantile, consensus, record, most_recorded,
         most_dropped, solver, log] = options;  // the log is not stored
  auto& [range, probability, min_loop_gain, min_pose_gain, link_covariance] = thresholds;
  archive(strategy, range, probability, plausible_quantile, max_registrations, failed_neighbourhood, min_loop_gain,
          min_pose_gain, link_covariance, distance, composition, innovation_quantile, consensus, record, most_recorded,
          most_dropped, min_variance_drop, retire_share, solver);
  auto& [keep_poses, keep_links, poses_per_area, error] = budget;
  archive(keep_poses, keep_links, poses_per_area, error);
}

template <class Archive, class Pose>
void Serialize(Archive& archive, CompactInput<Pose>& input) {
  auto& [id, odometry, T_world_body, fixed, priors, loops, linkable, keep] = input;
  archive(id, odometry, T_world_body, fixed, priors, loops, linkable, keep);
}

// Those of the classes are compiled in the library.
#define TERSE_EXTERN_STATE(Archive, Pose) extern template void CompactPoseSlam<Pose>::Serialize<Archive>(Archive&);
TERSE_EXTERN_STATE(StateWriter, SE2)
TERSE_EXTERN_STATE(StateReader, SE2)
TERSE_EXTERN_STATE(StateWriter, SE3)
TERSE_EXTERN_STATE(StateReader, SE3)
#undef TERSE_EXTERN_STATE

}  // namespace terse
