#pragma once
// What the parts of CompactPoseSlam share while a pose is worked in.

#include "gain_control.h"
#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/pose_index.h"

namespace terse {

// All updates of a step as one report.
void Accumulate(const StepReport& update, std::optional<StepReport>& sum);

// As a factor of the optimiser.
template <class Pose>
RelativePoseFactor<Pose> Measurement(PoseId from, PoseId to, const UncertainPose<Pose>& T_from_to,
                                     CompositionOrder order);

// The chain from `middle` on, of one from `start` through `middle`, by subtraction of covariances. Absent where nothing
// but rounding is left.
template <class Pose>
std::optional<UncertainPose<Pose>> Behind(const UncertainPose<Pose>& T_start_middle,
                                          const UncertainPose<Pose>& T_start_end);

// Refused for its innovation, and no others agree with it.
inline bool IsRefused(const Candidate& link) { return link.outlier && !link.supported; }

// Between two kept poses, or, where the chain has not ended yet, on that of the pose at hand.
template <class Pose>
struct CompactPoseSlam<Pose>::Revival {
  PoseId pose, base;
  UncertainPose<Pose> T_base_pose, T_pose_next;
  std::optional<PoseId> next;
  FactorId replaced;  // from base to next
  int newest = -1;    // the last pose of the chain, in history_
};

template <class Pose>
struct CompactPoseSlam<Pose>::Offer {
  RelativePoseFactor<Pose> measured;
  RelativePoseFactor<Pose> link;       // between the pose at hand and the kept pose that it was carried to
  UncertainPose<Pose> T_kept_current;  // the same
  PoseId kept;
  std::optional<PoseId> carried_from;
  typename Pose::Jacobian carried;  // what the chain adds to the loop's own covariance
  // From the dropped pose, if the pose at hand hangs on the same chain behind it.
  std::optional<UncertainPose<Pose>> T_dropped_current;
};

template <class Pose>
struct CompactPoseSlam<Pose>::Ask {
  int pose = -1;   // solver index
  int offer = -1;  // in Current::offers; -1: it has to be registered
};

// A position prior on a pose behind the end of a chain as one on the pose at its start, with the chain's translation as
// (more of) its lever arm and the chain's covariance added, turned into the world as the pose at its start is. If how
// that is turned is not known (`is_turned` false), its largest variance in every direction instead.
template <class Pose>
PositionPriorFactor<Pose> CarryPosition(const PositionPriorFactor<Pose>& prior, PoseId base,
                                        const UncertainPose<Pose>& T_base_pose, const Pose& T_world_base,
                                        bool is_turned);

// The record of a decision stays small however many poses were in range: what was tried, and the best of the others.
template <class Pose>
void RecordCandidates(std::vector<Candidate> settled, const CompactOptions<Pose>& options, Decision& decision);

template <class Pose>
struct CompactPoseSlam<Pose>::Sighting {
  int offer = -1;       // in Current::offers
  double log_det = 0;   // of what it leaves open of where the robot is
  double map_gain = 0;  // what it tells of the map, with the chain, nats
};

template <class Pose>
struct CompactPoseSlam<Pose>::NewEdge {
  PoseId a, b;
  UncertainPose<Pose> T_a_b;
  double gain = 0;            // about the map, nats
  std::vector<int> offers;    // in Current::offers; one: with the chain from a
  std::vector<PoseId> links;  // where they lead to as measured
  FactorId id = {};
  bool fused = false;  // with an edge that was there
};

template <class Pose>
struct CompactPoseSlam<Pose>::Evaluated {
  Ask ask;
  UncertainPose<Pose> T_pose_current;
  Candidate record;
  double worth = 0;       // nats that trying it promises
  bool plausible = true;  // in range, as far as is known
};

template <class Pose>
struct CompactPoseSlam<Pose>::Current {
  const CompactInput<Pose>* input = nullptr;
  int previous = -1;  // in history_
  int parent = -1;    // likewise
  PoseId base;        // the kept pose its chain hangs on; itself once it is in the solver
  UncertainPose<Pose> T_base_current;
  UncertainPose<Pose> chain;  // T_base_current as it came in, when base was still another pose
  Pose T_world_body;
  std::vector<Offer> offers;
  std::vector<std::pair<PoseId, double>> in_range;  // kept poses, with the probability of it; for CompactBudget::error
  FactorId odometry;
  bool in_solver = false;
  bool concatenated = false;         // poses were dropped between base and this one
  bool is_anchored = false;          // its chain has started anew, with a link of its own
  UncertainPose<Pose> T_ended_base;  // if so: from the base of the chain before to that of this one
  std::optional<StepReport> update;
};

}  // namespace terse
