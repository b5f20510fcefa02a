#pragma once
// Compact pose SLAM: keeps the poses and links that carry information (Ila et al., IJRR 2017,
// section 4, Algorithm 1; equation numbers are theirs, see docs/algorithms.md).
//
// For every new pose n:
//  1. its odometry is concatenated over the poses dropped since the last kept one;
//  2. kept poses within sensor range of n, given what is known of the displacement, are candidates (distance.h);
//  3. they are ranked by the information a link would add (information.h) and registered, best first; a link whose
//     measured gain exceeds min_loop_gain is added, and the rest is evaluated again;
//  4. n is kept if a loop closed, if nothing is in range, or if even the least informative possible link, the last kept
//     pose among them, would add more than min_pose_gain; otherwise it is dropped and only its chain is remembered.
//
// A pose enters the solver when it is kept, so dropping one costs nothing. Until then its covariance and
// cross-covariances follow, to first order, from those of the kept pose its chain hangs on.
//
// A link must first pass the innovation test (innovation.h): a wrong link has high information.
//
// AddPose throws std::invalid_argument or NumericalError and leaves the state as before. What the registration callback
// throws, or a defective link that it returns throws, passes through; links accepted before it, and the pose with
// them, stay (none with kApal, which adds all links at once). Not thread-safe.

#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "terse/compact/compact_options.h"
#include "terse/compact/decision.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {

template <class Pose>
class PoseIndex;
template <class Pose>
struct CompactMap;

// How dropped poses come back. kV0: as estimated when they were dropped. kV1 (Eq. 24): chained to the kept pose before
// them. kV2 (Eqs. 25-26): that chain's misfit at the next kept pose spread over it by its covariance; behind the last
// kept pose as kV1.
enum class Recovery { kV0, kV1, kV2 };

template <class Pose>
struct RecoveredPose {
  PoseId id;
  bool kept = true;
  Pose T_world_body;
};

// Of a link between poses seen before (CompactPoseSlam::AddLink).
struct LinkDecision {
  PoseId from, to;                   // the kept poses that it was carried to
  double gain = 0;                   // nats, with the measured covariance
  std::optional<double> innovation;  // squared Mahalanobis distance; absent if it was not tested
  bool outlier = false, accepted = false;
  std::optional<FactorId> factor;  // if accepted
};

template <class Pose>
class CompactPoseSlam {
 public:
  // Throws std::invalid_argument if an option is out of its domain.
  explicit CompactPoseSlam(const CompactOptions<Pose>& options = {});
  ~CompactPoseSlam();
  CompactPoseSlam(CompactPoseSlam&&) noexcept;
  CompactPoseSlam& operator=(CompactPoseSlam&&) noexcept;

  Decision AddPose(const CompactInput<Pose>& input, const Registration<Pose>& registration);

  // A link that comes late, between any two poses seen: carried to the kept poses (CarryToKept), then tested as those
  // of AddPose are. Throws std::invalid_argument for unknown poses, a defective link, or if both ends hang on the same
  // kept pose.
  LinkDecision AddLink(const RelativePoseFactor<Pose>& link);
  // Takes a link out again that was found wrong; the map is as optimal without it as with it. Throws
  // std::invalid_argument if there is no such link, or if it is odometry; NumericalError if the map needs it.
  void RemoveLink(FactorId id);
  // The same measurement between the kept poses that its ends hang on: T_base_pose of a dropped end composed to it, the
  // covariance too. (The chain's error is counted in the map's odometry as well; the two are taken as independent.)
  RelativePoseFactor<Pose> CarryToKept(const RelativePoseFactor<Pose>& link) const;
  // The same for one end alone: the other may be a pose that is yet to come. Throws std::invalid_argument if `end` is
  // no end of the link or unknown.
  RelativePoseFactor<Pose> CarryEndToKept(PoseId end, const RelativePoseFactor<Pose>& link) const;
  // A prior that comes late, on any pose seen. On a dropped pose it is carried to the kept one that the pose hangs on: a
  // pose prior by composition, a position prior with the chain's translation as its lever arm, the chain's covariance
  // added to both. (As with CarryToKept, the chain's error is taken as independent.) Throws std::invalid_argument for
  // an unknown pose or a defective prior.
  FactorId AddPrior(const Factor<Pose>& prior);
  // A kept pose itself, for a dropped one the kept pose that it hangs on. Throws std::invalid_argument if unknown.
  PoseId KeptBase(PoseId id) const { return Find(id).base; }
  bool HasSeen(PoseId id) const { return index_.count(id.value) != 0; }

  // The kept poses and links.
  const IncrementalSolver<Pose>& Solver() const { return *solver_; }
  const CompactOptions<Pose>& Options() const { return options_; }
  // Iterates the kept graph to its optimum.
  BatchResult<Pose> Finish();
  // All poses in order of arrival.
  std::vector<RecoveredPose<Pose>> Trajectory(Recovery recovery = Recovery::kV2) const;
  // Of any pose seen, kept or dropped, in the present map (as kV1).
  Pose Estimate(PoseId id) const;

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

  int PosesSeen() const { return static_cast<int>(history_.size()); }
  int LinksKept() const { return static_cast<int>(links_.size()); }

 private:
  // Where a pose hangs: itself if kept (identity), else the kept pose before it.
  struct Seen {
    PoseId id, base;
    UncertainPose<Pose> T_base_pose;
    Pose T_world_body_when_seen;
    int previous = -1;  // the pose its odometry comes from, in history_
    bool kept = true;
    // A dropped pose's chain as it ends at the next kept pose.
    std::optional<PoseId> next_kept;
    UncertainPose<Pose> T_base_next;
  };
  struct Link {
    FactorId factor;
    PoseId added_at;             // the last pose seen then
    std::optional<double> gain;  // nats, measured
  };
  // A link that the innovation test refused.
  struct Refused {
    PoseId candidate, seen;
    UncertainPose<Pose> T_candidate_seen;
  };
  struct Evaluated;  // a candidate with its covariance
  struct Current;    // the pose at hand

  // compact_pose_slam.cpp
  void TakeOptions(const CompactOptions<Pose>& options);
  Current Start(const CompactInput<Pose>& input) const;
  void CheckPose(const CompactInput<Pose>& input) const;
  void CloseLoops(Current& current, std::vector<Evaluated>& candidates, Decision& decision,
                  const Registration<Pose>& registration);
  bool TryLink(const Current* current, const UncertainPose<Pose>& known, const UncertainPose<Pose>& measured,
               Candidate& record);
  void LogLink(PoseId a, PoseId b, const Candidate& record, bool good) const;
  void LogVerdict(const Decision& decision) const;
  void LinkAll(Current& current, Decision& decision, const Registration<Pose>& registration);
  void Judge(const Current& current, Decision& decision) const;
  std::vector<FactorId> Keep(Current& current, std::vector<Factor<Pose>> links);
  void Remember(const Current& current);
  std::optional<RelativePoseFactor<Pose>> Register(const Registration<Pose>& registration, PoseId candidate,
                                                   PoseId current) const;
  const Seen& Find(PoseId id) const;
  RelativePoseFactor<Pose> Carry(const RelativePoseFactor<Pose>& link, const Seen* from, const Seen* to) const;
  // compact_search.cpp
  void UpdateCovariances();
  void UpdateSearch(int base);
  std::vector<int> InReach(const Current& current);
  std::vector<Evaluated> Evaluate(const Current& current, const std::vector<int>& poses) const;
  // compact_map.cpp
  std::vector<PoseId> ComposedOf(const RelativePoseFactor<Pose>& edge) const;
  void TakeHistory(const CompactMap<Pose>& map);
  // compact_outliers.cpp
  UncertainPose<Pose> Between(PoseId a, PoseId b) const;
  bool IsSupported(const Current& current, PoseId candidate, const UncertainPose<Pose>& measured) const;
  void RememberRefused(const Current& current, PoseId candidate, const UncertainPose<Pose>& measured);
  // compact_state.cpp
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);

  CompactOptions<Pose> options_;
  double most_innovation_ = 0;  // infinite without the test
  std::unique_ptr<IncrementalSolver<Pose>> solver_;
  std::unique_ptr<IncrementalMarginals<Pose>> marginals_;
  std::vector<Seen> history_;
  std::unordered_map<std::int64_t, int> index_;  // into history_
  std::vector<Link> links_;                      // ascending factors
  std::vector<Refused> refused_;                 // the last ones
  bool searches_ = false;                        // covariances are kept with every change
  // Of all kept poses, as seen from them: the kept pose that the search was last made ready for, with covariances.
  std::vector<UncertainPose<Pose>> T_pose_base_;
  std::unique_ptr<PoseIndex<Pose>> reach_;
  std::uint64_t searched_version_ = 0;  // of the factor
  int searched_base_ = -1;
};

extern template class CompactPoseSlam<SE2>;
extern template class CompactPoseSlam<SE3>;

}  // namespace terse
