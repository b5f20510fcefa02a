#pragma once
// What the parts of CompactPoseSlam share while a pose is worked in.

#include "pose_index.h"
#include "terse/compact/compact_pose_slam.h"

namespace terse {

// All updates of a step as one report.
void Accumulate(const StepReport& update, std::optional<StepReport>& sum);

// A position prior on a pose behind the end of a chain as one on the pose at its start, with the chain's translation as
// (more of) its lever arm and the chain's covariance added, turned into the world as the pose at its start is. If how
// that is turned is not known (`is_turned` false), its largest variance in every direction instead.
template <class Pose>
PositionPriorFactor<Pose> CarryPosition(const PositionPriorFactor<Pose>& prior, PoseId base,
                                        const UncertainPose<Pose>& T_base_pose, const Pose& T_world_base,
                                        bool is_turned);

template <class Pose>
struct CompactPoseSlam<Pose>::Evaluated {
  int pose = -1;  // solver index
  UncertainPose<Pose> T_pose_current;
  Candidate record;
};

template <class Pose>
struct CompactPoseSlam<Pose>::Current {
  const CompactInput<Pose>* input = nullptr;
  int previous = -1;  // in history_
  PoseId base;        // the kept pose its chain hangs on; itself once it is in the solver
  UncertainPose<Pose> T_base_current;
  UncertainPose<Pose> chain;  // T_base_current as it came in, when base was still another pose
  Pose T_world_body;
  bool in_solver = false;
  bool concatenated = false;  // poses were dropped between base and this one
  std::optional<StepReport> update;
};

}  // namespace terse
