#pragma once
// What compact pose SLAM decided, and on what grounds.

#include <optional>
#include <vector>

#include "terse/core/step_report.h"

namespace terse {

// A kept pose that the new one may be linked to.
struct Candidate {
  PoseId id;
  double probability = 0;  // smallest over the dimensions
  // Nats, with the expected link covariance; of a loop that came with the pose with its own.
  double gain = 0;
  bool measured = false;  // it is a loop that came with the pose
  bool tried = false;
  std::optional<double> measured_gain;  // nats, with the registered covariance; absent if registration failed
  std::optional<double> innovation;     // squared Mahalanobis distance (innovation.h); absent if it is not tested
  bool outlier = false;                 // the innovation is too large, or the map has no solution with it: not linked
  bool supported = false;               // it was, but others agree with it (CompactOptions::consensus)
  bool accepted = false;
  std::optional<FactorId> factor;      // if accepted: CompactPoseSlam::RemoveLink takes it
  std::optional<PoseId> carried_from;  // the dropped pose that the loop was measured at
  // kBounded, what the link served for if not as a factor of its own: the chain starts anew with it; it is part of an
  // edge between kept poses.
  bool anchors = false, composed = false;
};

enum class PoseVerdict {
  kFirst,
  kAllKept,
  kLoopClosed,
  kPrior,
  kNothingInRange,
  kInformative,
  kRedundant,
  kGiven,
  kAnchored
};
const char* Name(PoseVerdict verdict);

// A measurement between kept poses, composed of links of a pose that is not kept (Strategy::kBounded).
struct ComposedEdge {
  FactorId id;  // CompactPoseSlam::RemoveLink takes it
  PoseId from, to;
  double gain = 0;     // about the map, nats
  bool fused = false;  // with an edge that joined the two already
};

// That the map did without from then on (retire_poses.h).
struct RetiredPose {
  PoseId id;
  double loss = 0;     // nats: 1/2 ln |Sigma_tree| / |Sigma_exact| of its neighbours' displacements
  int neighbours = 0;  // that it had
  int factors_removed = 0, factors_recovered = 0;
};

struct Decision {
  PoseId id;
  // In the order they were settled, as last evaluated; of those not tried the best by gain (CompactOptions::record).
  // With kApal and kGiven: what was registered, without probabilities and gains.
  std::vector<Candidate> candidates;
  int candidates_found = 0;  // all of them
  PoseVerdict verdict = PoseVerdict::kFirst;
  // Least gain among the possible links, before any was added, nats; absent when nothing was in range.
  std::optional<double> pose_gain;
  int registrations_tried = 0;
  int links_accepted = 0;
  int links_refused = 0;    // as outliers
  int loops_forgotten = 0;  // that came with the pose and lead to forgotten ones (CompactOptions::most_dropped)
  // Poses dropped earlier that are kept from now on, because a loop of this pose leads to them.
  std::vector<PoseId> revived;
  // kBounded: poses kept earlier that are dropped ones from now on, because the map does without them
  // (CompactOptions::retire_share). Links that they had went into factors between their neighbours, and cannot be taken
  // out one by one any more.
  std::vector<RetiredPose> retired;
  // kBounded: the kept pose at which the chain started anew, and the edges that the pose's links made.
  std::optional<PoseId> anchored_to;
  std::vector<ComposedEdge> edges;
  // All updates of the map in this step together (one per link that is added; with kApal one for all): whether any
  // opened the gate, the greatest gate value, sums of work. Absent if the map did not
  // change.
  std::optional<StepReport> update;
  bool Kept() const { return verdict != PoseVerdict::kRedundant && verdict != PoseVerdict::kAnchored; }
};

// Of a link between poses seen before (CompactPoseSlam::AddLink).
struct LinkDecision {
  PoseId from, to;                   // the kept poses that it was carried to
  double gain = 0;                   // nats, with the measured covariance
  std::optional<double> innovation;  // squared Mahalanobis distance; absent if it was not tested
  bool outlier = false, accepted = false;
  std::optional<FactorId> factor;  // if accepted
};

}  // namespace terse
