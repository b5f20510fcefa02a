#pragma once
// Compact pose SLAM: keeps the poses and links that carry information (Ila et al. 2017,
// section 4, Algorithm 1; equation numbers are theirs, see docs/algorithms.md).
//
// For every new pose n:
//  1. its odometry is concatenated over the poses dropped since the last kept one;
//  2. kept poses that may be within sensor range of n, given what is known of the displacement, are candidates
//     (distance.h);
//  3. they are ranked by the information that registering them promises (information.h, Ila et al. 2017 Eq. 18) and
//  registered, best
//     first, up to max_registrations; a link whose measured gain exceeds min_loop_gain is added, and the rest is
//     evaluated again. Loops that came with n take the place of 2 and of the registration, and compete by their gain;
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
// A link must first pass the innovation test (innovation.h): a wrong link has high information. One with which the map
// would have no solution is refused too.
//
// AddPose throws std::invalid_argument or NumericalError and leaves the state as before. What the registration callback
// throws, or a defective link that it returns throws, passes through; links accepted before it, and the pose with
// them, stay (none with kApal, which adds all links at once). Not thread-safe.

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "terse/compact/compact_map.h"
#include "terse/compact/compact_options.h"
#include "terse/compact/decision.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/incremental_marginals.h"

namespace terse {

template <class Pose>
class PoseIndex;
template <class Pose>
class FusedEdges;
template <class Pose>
class GainControl;

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

  int PosesSeen() const { return static_cast<int>(history_.size()); }
  int LinksKept() const { return static_cast<int>(links_.size()); }

 private:
  using Jacobian = typename Pose::Jacobian;
  // Where a pose hangs: itself if kept (identity), else the kept pose before it.
  struct Seen {
    PoseId id, base;
    UncertainPose<Pose> T_base_pose;
    Pose T_world_body_when_seen;
    int previous = -1;  // the pose its odometry comes from, in history_
    // The pose that its chain comes from: the same, unless a link has anchored it to another one.
    int parent = -1;
    int successors = 0;  // poses whose chain comes from it
    bool kept = true;
    bool anchored = false;
    // A dropped pose's chain as it ends at the next kept pose: with that one's odometry, or with a link of the pose
    // `ended_by`, which was anchored.
    std::optional<PoseId> next_kept;
    UncertainPose<Pose> T_base_next;
    int ended_by = -1;
    // Chains are measured in stretches: from a kept pose or a link on. The first pose of this one's, in history_ (-1 of
    // a kept pose), and there, whether it served to carry a loop of another pose: once is all.
    int stretch = -1;
    bool carried = false;
    FactorId odometry;  // of a kept pose but the first: the factor that it came in with
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
  // A registration that failed.
  struct Failed {
    PoseId candidate, seen;
  };
  struct Revival;    // a dropped pose as it comes back
  struct Offer;      // a loop that came with the pose at hand
  struct Ask;        // a pose that may be linked
  struct Evaluated;  // one with what is known of it
  struct Current;    // the pose at hand
  struct Sighting;   // a loop of the pose at hand that agrees with the map
  struct NewEdge;    // composed of measurements, between kept poses
  struct ChangedEdges;

  // compact_pose_slam.cpp
  void TakeOptions(const CompactOptions<Pose>& options);
  Current Start(const CompactInput<Pose>& input) const;
  void CheckPose(const CompactInput<Pose>& input) const;
  void LogVerdict(const Decision& decision) const;
  void Judge(const Current& current, Decision& decision) const;
  std::vector<FactorId> Keep(Current& current, std::vector<Factor<Pose>> links, const Revival* revival = nullptr);
  int StretchBehind(int parent, bool anchored, int at) const;
  void EndChain(int last, PoseId next, const UncertainPose<Pose>& T_base_next, int ended_by);
  void Remember(const Current& current);
  const Seen& Find(PoseId id) const;
  RelativePoseFactor<Pose> Carry(const RelativePoseFactor<Pose>& link, const Seen* from, const Seen* to) const;
  // compact_loops.cpp
  void TakeOffers(Current& current) const;
  int StretchBefore(int stretch) const;
  bool IsSpent(PoseId dropped) const;
  void SpendChain(int pose);
  void Spend(const Offer& offer);
  bool TakeOffer(const Current& current, const RelativePoseFactor<Pose>& loop, Offer& offer) const;
  void Search(Current& current, Decision& decision, const Registration<Pose>& registration);
  void CloseLoops(Current& current, std::vector<Evaluated> candidates, Decision& decision,
                  const Registration<Pose>& registration);
  void LinkAll(Current& current, Decision& decision, const Registration<Pose>& registration);
  bool IsBelieved(const Current* current, const UncertainPose<Pose>& known, const UncertainPose<Pose>& measured,
                  Candidate& record);
  bool PassesTests(const Current* current, const UncertainPose<Pose>& known, const UncertainPose<Pose>& measured,
                   Candidate& record);
  bool Accept(Current& current, Evaluated& candidate, const RelativePoseFactor<Pose>& link, Decision& decision);
  bool AcceptOnChain(Current& current, const Offer& offer, Candidate& record, Decision& decision);
  bool IsCostlyToCarry(const Offer& offer, const UncertainPose<Pose>& known) const;
  std::optional<RelativePoseFactor<Pose>> Register(const Registration<Pose>& registration, PoseId candidate,
                                                   PoseId current) const;
  void LogLink(PoseId a, PoseId b, const Candidate& record, bool good) const;
  std::vector<Failed> FailedNear(const Current& current) const;
  bool IsNearFailed(const std::vector<Failed>& failed, PoseId candidate) const;
  bool AreNeighbours(const Pose& T_world_a, const Pose& T_world_b) const;
  // compact_bounded.cpp
  void Bound(Current& current, Decision& decision, const Registration<Pose>& registration);
  double MapGain(const Current& current, const UncertainPose<Pose>& known, const Jacobian& Sigma_link) const;
  void ThinOffers(Current& current) const;
  void Sight(const Current& current, int offer, Decision& decision, std::vector<Evaluated>& candidates,
             std::vector<Sighting>& sightings);
  void RegisterSightings(Current& current, Decision& decision, const Registration<Pose>& registration,
                         std::vector<Evaluated>& candidates, std::vector<Sighting>& sightings);
  void Anchor(Current& current, Decision& decision, std::vector<Evaluated>& candidates,
              std::vector<Sighting> sightings);
  std::vector<NewEdge> ComposeEdges(const Current& current, std::vector<Sighting> sightings) const;
  // compact_edges.cpp
  double LeastEdgeGain(PoseId a, PoseId b) const;
  void RememberEdge(const Factor<Pose>& factor, FactorId id, bool is_odometry);
  typename std::vector<Link>::iterator FindLink(FactorId id);
  typename CompactMap<Pose>::Part FirstPart(PoseId from, PoseId to, FactorId factor);
  void AddEdges(PoseId added_at, std::vector<NewEdge>& edges, Decision& decision, std::optional<StepReport>& report);
  void ReplaceEdges(PoseId added_at, ChangedEdges& changed, std::optional<StepReport>& report);
  // compact_revival.cpp
  bool IsPlainChain(PoseId dropped, int newest, int successors_of_newest) const;
  std::optional<Revival> PlanRevival(PoseId dropped) const;
  Revival PlanRevivalOnChain(PoseId dropped, const Current& current) const;
  void AddRevival(const Revival& revival, GraphUpdate<Pose>& update) const;
  void ReviveEdges(const Revival& revival, const std::vector<FactorId>& ids);
  void Revive(const Revival& revival, const std::vector<FactorId>& ids);
  // compact_search.cpp
  void UpdateCovariances();
  void UpdateSearch(int base);
  UncertainPose<Pose> KnownDisplacement(int pose, int base) const;
  UncertainPose<Pose> DisplacementAt(int pose, int base, const Jacobian& cross) const;
  double OfferGain(const Current& current, const Offer& offer, const UncertainPose<Pose>& known,
                   const Jacobian& Sigma_link) const;
  std::vector<Ask> InReach(const Current& current, bool plausible);
  std::vector<Evaluated> Evaluate(const Current& current, const std::vector<Ask>& asks, bool plausible) const;
  // compact_recovery.cpp
  struct Bridge;
  struct Error;
  int EndedByLink(int by) const;
  int ParentOnChain(int at) const;
  int EndedBefore(int pose) const;
  Bridge BridgeOf(const Seen& seen, int ended) const;
  Pose Recover(const Seen& seen, int ended) const;
  Error ErrorOf(PoseId id) const;
  typename Pose::Jacobian CovarianceOf(const Error& error) const;
  typename Pose::Jacobian ChainCovariance(const Error& error) const;
  // compact_map.cpp
  std::vector<PoseId> ComposedOf(const RelativePoseFactor<Pose>& edge) const;
  void RestoreEdge(const typename CompactMap<Pose>::Edge& edge, FactorId factor);
  void TakeHistory(const CompactMap<Pose>& map);
  // compact_outliers.cpp
  UncertainPose<Pose> Between(PoseId a, PoseId b) const;
  UncertainPose<Pose> FromSeen(PoseId id, const Current& current) const;
  bool IsSupported(const Current& current, PoseId candidate, const UncertainPose<Pose>& measured) const;
  void RememberRefused(const Current& current, PoseId candidate, const UncertainPose<Pose>& measured);
  // compact_state.cpp
  friend struct internal::StateAccess;
  template <class Archive>
  void Serialize(Archive& archive);

  CompactOptions<Pose> options_;
  double most_innovation_ = 0;  // infinite without the test
  double most_distance_ = 0;    // squared, of the range from the mean of a plausible displacement
  std::unique_ptr<IncrementalSolver<Pose>> solver_;
  std::unique_ptr<IncrementalMarginals<Pose>> marginals_;
  std::unique_ptr<GainControl<Pose>> gains_;  // the thresholds in force
  std::vector<Seen> history_;
  std::unordered_map<std::int64_t, int> index_;  // into history_
  std::vector<Link> links_;                      // ascending factors
  std::unique_ptr<FusedEdges<Pose>> fused_;      // kBounded: what joins kept poses
  std::vector<Refused> refused_;                 // the last ones
  std::vector<Failed> failed_;                   // likewise
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
