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
// AddPose throws std::invalid_argument or NumericalError and leaves the state as before. What the registration callback
// throws, or a defective link that it returns throws, passes through; links accepted before it, and the pose with
// them, stay (none with kApal, which adds all links at once). Not thread-safe.

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "terse/compact/distance.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/selected_inverse.h"

namespace terse {

// All poses and all links; all poses and links that pass the tests; few poses, few links.
enum class Strategy { kApal, kApfl, kFpfl };
const char* Name(Strategy strategy);

template <class Pose>
struct CompactOptions {
  Strategy strategy = Strategy::kFpfl;
  // Sensor range per dimension of the displacement: metres, then radians.
  Vector<Displacement<Pose>::kSize> range = Vector<Displacement<Pose>::kSize>::Constant(1);
  double probability = 0.1;    // s: every dimension must be in range with more than this
  double min_loop_gain = 1.0;  // g_loop, nats
  double min_pose_gain = 3.0;  // g_pose, nats
  // Covariance expected of a registration, body frame of the newer pose.
  typename Pose::Jacobian link_covariance = 0.01 * Pose::Jacobian::Identity();
  Vector<3> view_axis = {0, 0, 1};  // body frame, 3D only
  IncrementalOptions solver;
};

// Measures T_candidate_current, given in either direction; nullopt when the two do not match.
template <class Pose>
using Registration = std::function<std::optional<RelativePoseFactor<Pose>>(PoseId candidate, PoseId current)>;

template <class Pose>
struct CompactInput {
  PoseId id;
  // To an earlier pose, kept or dropped, in either direction. Absent for the very first pose only.
  std::optional<RelativePoseFactor<Pose>> odometry;
  std::optional<Pose> T_world_body = std::nullopt;  // of the first pose (default identity) and of fixed ones
  bool fixed = false;                               // kept, and anchored at T_world_body
  std::vector<Factor<Pose>> priors;                 // on this pose; a pose with priors is kept
  // The poses known to be linkable, if known: APAL registers these (twice if named twice) instead of searching.
  std::optional<std::vector<PoseId>> linkable = std::nullopt;
};

struct Candidate {
  PoseId id;
  double probability = 0;  // smallest over the dimensions
  double gain = 0;         // nats, with the expected link covariance
  bool tried = false;
  std::optional<double> measured_gain;  // nats, with the registered covariance; absent if registration failed
  bool accepted = false;
};

enum class PoseVerdict { kFirst, kAllKept, kLoopClosed, kPrior, kNothingInRange, kInformative, kRedundant };
const char* Name(PoseVerdict verdict);

struct Decision {
  PoseId id;
  // In the order they were settled, as last evaluated. With kApal: what was registered, without probabilities and
  // gains.
  std::vector<Candidate> candidates;
  PoseVerdict verdict = PoseVerdict::kFirst;
  // Least gain among the possible links, before any was added, nats; absent when nothing was in range.
  std::optional<double> pose_gain;
  int registrations_tried = 0;
  int links_accepted = 0;
  bool Kept() const { return verdict != PoseVerdict::kRedundant; }
};

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

template <class Pose>
class CompactPoseSlam {
 public:
  // Throws std::invalid_argument if an option is out of its domain.
  explicit CompactPoseSlam(const CompactOptions<Pose>& options);

  Decision AddPose(const CompactInput<Pose>& input, const Registration<Pose>& registration);

  // What is known of the pose to come as seen from kept poses: T_pose_new, before any link. Changes nothing.
  // Throws std::invalid_argument before the first pose and for a pose that is not kept.
  std::vector<UncertainPose<Pose>> Predict(const CompactInput<Pose>& input, const std::vector<PoseId>& from) const;

  // The kept poses and links.
  const IncrementalSolver<Pose>& Solver() const { return *solver_; }
  // Iterates the kept graph to its optimum.
  BatchResult<Pose> Finish() { return solver_->Finish(); }
  // All poses in order of arrival.
  std::vector<RecoveredPose<Pose>> Trajectory(Recovery recovery = Recovery::kV2) const;
  // Of any pose seen, kept or dropped, in the present map (as kV1).
  Pose Estimate(PoseId id) const;

  int PosesSeen() const { return static_cast<int>(history_.size()); }
  int LinksKept() const { return links_kept_; }

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
  // How far off, root mean square, the relative pose of a kept pose to the newest can be (an upper bound).
  struct Bound {
    double metres = 0, radians = 0;
  };
  struct Evaluated;  // a candidate with its covariance
  struct Current;    // the pose at hand

  Current Start(const CompactInput<Pose>& input) const;
  std::vector<Bound> PropagateBounds(const Current& current) const;
  std::vector<int> Prefilter(const Current& current) const;
  std::vector<UncertainPose<Pose>> Displacements(const Current& current, const std::vector<int>& poses) const;
  std::vector<Evaluated> Evaluate(Current& current, const std::vector<int>& poses) const;
  void CloseLoops(Current& current, std::vector<Evaluated>& candidates, Decision& decision,
                  const Registration<Pose>& registration);
  void LinkAll(Current& current, Decision& decision, const Registration<Pose>& registration);
  void Judge(const Current& current, Decision& decision) const;
  void Keep(Current& current, std::vector<Factor<Pose>> links);
  void Remember(const Current& current);
  std::optional<RelativePoseFactor<Pose>> Register(const Registration<Pose>& registration, PoseId candidate,
                                                   PoseId current) const;
  const Seen& Find(PoseId id) const;

  CompactOptions<Pose> options_;
  double deviations_ = 0;  // of the prefilter
  std::unique_ptr<IncrementalSolver<Pose>> solver_;
  std::unique_ptr<SelectedInverse<Pose::kDof>> inverse_;
  std::vector<Seen> history_;
  std::unordered_map<std::int64_t, int> index_;  // into history_
  std::vector<Bound> bounds_;                    // by solver pose index, to the newest pose
  int links_kept_ = 0;
  int absolute_poses_ = 0;  // fixed or with priors
};

extern template class CompactPoseSlam<SE2>;
extern template class CompactPoseSlam<SE3>;

}  // namespace terse
