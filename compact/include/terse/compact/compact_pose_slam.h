#pragma once
// Compact pose SLAM: keeps the poses and links that carry information (Ila et al. 2017, section 4, Algorithm 1;
// equation numbers are theirs, see docs/algorithms.md).
//
// For every new pose n:
//  1. its odometry is concatenated over the poses dropped since the last kept one;
//  2. kept poses that may be within sensor range of n, given what is known of the displacement, are candidates
//     (distance.h);
//  3. they are ranked by the information that registering them promises (information.h, Ila et al. 2017 Eq. 18) and
//     registered, best first, up to max_registrations; a link whose measured gain exceeds min_loop_gain is added, and
//     the rest is evaluated again. Loops that came with n take the place of 2 and of the registration, and compete by
//     their gain;
//  4. n is kept if a loop closed, if nothing is in range, or if even the least informative possible link, the last kept
//     pose among them, would add more than min_pose_gain; otherwise it is dropped and only its chain is remembered.
//
// A pose enters the solver when it is kept, so dropping one costs nothing. Until then its covariance and
// cross-covariances follow, to first order, from those of the kept pose its chain hangs on.
//
// A loop to a dropped pose is carried to the kept pose which that one hangs on, along its chain. Where the chain would
// cost more of what the loop tells than min_loop_gain the dropped pose comes back instead: the odometry that was
// concatenated over it is split at it (Decision::revived).
//
// With Strategy::kBounded a pose that links find in known terrain is not kept: its chain starts anew at a kept pose,
// and its other links become measurements between kept poses, so the map grows with the area and not with time
// (docs/algorithms.md).
//
// A link must first pass the innovation test (innovation.h): a wrong link has high information. One with which the map
// would have no solution is refused too.
//
// AddPose throws std::invalid_argument or NumericalError and leaves the state as before. What the registration callback
// throws, or a defective link that it returns throws, passes through; links accepted before it, and the pose with
// them, stay (none with kApal, which adds all links at once). Not thread-safe.

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "terse/compact/compact_map.h"
#include "terse/compact/compact_options.h"
#include "terse/compact/decision.h"
#include "terse/compact/recovery.h"
#include "terse/compact/retire_poses.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {

namespace internal {
template <class Pose>
struct CompactParts;
}

template <class Pose>
class CompactPoseSlam {
 public:
  // Throws std::invalid_argument if an option is out of its domain.
  explicit CompactPoseSlam(const CompactOptions<Pose>& options = {});
  ~CompactPoseSlam();
  CompactPoseSlam(CompactPoseSlam&&) noexcept;
  CompactPoseSlam& operator=(CompactPoseSlam&&) noexcept;

  // The common case: a pose, how it was reached from an earlier one (std::nullopt for the very first), and the sensor.
  // A null registration registers nothing, like one that always returns std::nullopt.
  Decision AddPose(PoseId id, const std::optional<RelativePoseFactor<Pose>>& odometry,
                   const Registration<Pose>& registration = nullptr);
  // With all else that may be known of the pose: priors, loops that are measured already, where it is fixed.
  Decision AddPose(const CompactInput<Pose>& input, const Registration<Pose>& registration = nullptr);

  // A link that comes late, between any two poses seen: carried to the kept poses (CarryToKept), then tested as those
  // of AddPose are. Throws std::invalid_argument for unknown poses, a defective link, or if both ends hang on the same
  // kept pose.
  LinkDecision AddLink(const RelativePoseFactor<Pose>& link);
  // Takes a link out again that was found wrong; the map is as optimal without it as with it. One of several that make
  // an edge together (ComposedEdge, CompactMap::Part) leaves the others. Throws std::invalid_argument if there is no
  // such link, or if it is odometry; NumericalError if the map needs it.
  void RemoveLink(FactorId id);
  // The same measurement between the kept poses that its ends hang on: T_base_pose of a dropped end composed to it, the
  // covariance too. (The chain's error is counted in the map's odometry as well; the two are taken as independent.)
  RelativePoseFactor<Pose> CarryToKept(const RelativePoseFactor<Pose>& link) const;
  // The same for one end alone: the other may be a pose that is yet to come. Throws std::invalid_argument if `end` is
  // no end of the link or unknown.
  RelativePoseFactor<Pose> CarryEndToKept(PoseId end, const RelativePoseFactor<Pose>& link) const;
  // A prior that comes late, on any pose seen. On a dropped pose it is carried to the kept one that the pose hangs on:
  // a pose prior by composition, a position prior with the chain's translation as its lever arm, the chain's covariance
  // added to both. (As with CarryToKept, the chain's error is taken as independent.) Throws std::invalid_argument for
  // an unknown pose or a defective prior.
  FactorId AddPrior(const Factor<Pose>& prior);
  // A kept pose itself, for a dropped one the kept pose that it hangs on. Throws std::invalid_argument if unknown.
  PoseId KeptBase(PoseId id) const;
  // Whether a pose was seen and is remembered; and whether it was seen and is forgotten (CompactOptions::most_dropped).
  bool HasSeen(PoseId id) const;
  bool HasForgotten(PoseId id) const;
  // Which of two poses came later. Throws std::invalid_argument if one is unknown or forgotten.
  PoseId NewerOf(PoseId a, PoseId b) const;
  // How many are forgotten: whoever holds something of every pose drops it when this number changes.
  long PosesForgotten() const;

  // The kept poses and links.
  const IncrementalSolver<Pose>& Solver() const;
  const CompactOptions<Pose>& Options() const;
  // Poses retire from the map now (retire_poses.h): as CompactOptions::retire_share has it, nothing where that does not
  // apply; or those whose removal loses no more than this, nats, with any strategy. What is left comes to its optimum,
  // its factors keep their ids. The second throws std::invalid_argument for a negative loss and NumericalError, leaving
  // the map as it was, if that has no optimum.
  std::vector<RetiredPose> Retire();
  std::vector<RetiredPose> Retire(double most_loss);
  // Iterates the kept graph to its optimum.
  BatchResult<Pose> Finish();
  // All poses that are remembered, in order of arrival.
  std::vector<RecoveredPose<Pose>> Trajectory(Recovery recovery = Recovery::kV2) const;
  // Of any pose seen, kept or dropped, in the present map (as kV1).
  Pose Estimate(PoseId id) const;
  Pose Estimate(PoseId id, Recovery recovery) const;
  // Of any pose seen, kept or dropped, in the present map, to first order; of a dropped one where Recovery::kV2 puts
  // it: what the kept poses that its chain joins leave open, and what the chain does not know between them
  // (docs/algorithms.md). As if the dropped poses were in the graph with their odometry alone. O(length of the chain)
  // and two paths of the factor. Throws std::invalid_argument if unknown.
  typename Pose::Jacobian Covariance(PoseId id, const CovarianceConvention& convention = {}) const;
  // Of T_a_b, likewise; poses on one chain are correlated through it. Throws std::invalid_argument if a is b too.
  typename Pose::Jacobian RelativeCovariance(PoseId a, PoseId b, const CovarianceConvention& convention = {}) const;

  // The whole state, versioned, checksummed, written to a temporary file and renamed (core/state_file.h). What is
  // loaded continues bit by bit as the one saved would have, on the same build and processor family. Throw FileError.
  void Save(const std::string& path) const;
  static CompactPoseSlam Load(const std::string& path, LogSink log = {});
  void SetLog(LogSink log);  // the solver's too

  // The map as a plain value (compact_map.h), dropped poses recovered as asked for; and a run that continues from one,
  // its map brought to the optimum. Factors are numbered anew, in the same order. Throws std::invalid_argument if the
  // map contradicts itself (FindDefect says where), NumericalError if its measurements do not hold it.
  CompactMap<Pose> Export(Recovery recovery = Recovery::kV2) const;
  static CompactPoseSlam Restore(const CompactMap<Pose>& map, const CompactOptions<Pose>& options);

  int PosesSeen() const;  // forgotten ones too
  int LinksKept() const;

 private:
  using Parts = internal::CompactParts<Pose>;
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);

  std::unique_ptr<Parts> parts_;  // nullptr only of what was moved from
};

extern template class CompactPoseSlam<SE2>;
extern template class CompactPoseSlam<SE3>;

}  // namespace terse
