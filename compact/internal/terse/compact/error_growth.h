#pragma once
// By how much the position error of a compact map exceeds that of a map with all loops, as far as covariances tell.

#include <functional>
#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "terse/compact/compact_options.h"

namespace terse {

// What a pose brought of which a map of everything would make use.
template <class Pose>
struct SeenLoops {
  PoseId pose, base;                // the kept pose that it hung on when it came
  UncertainPose<Pose> T_base_pose;  // its chain
  struct Loop {
    PoseId kept;
    UncertainPose<Pose> T_kept_pose;
  };
  std::vector<Loop> measured;
  // Kept poses that were in range with this probability. Nobody asked the sensor, but for those that were tried.
  std::vector<std::pair<PoseId, double>> in_range;
  std::vector<PoseId> tried;
};

// Remembers what all loops seen tell of the displacements between kept poses, used or not: one information matrix per
// pair, so memory is bounded by the map. A loop of a dropped pose counts with its chain, composed, and one that nobody
// registered as the sensor would measure it, by its probability. Growth() compares two maps of the kept poses at the
// present estimate: the map as it is, and its odometry with all that was seen. The second counts a chain with every
// loop that comes along it, so it is rather too sure of itself, and the growth rather too large than too small.
template <class Pose>
class ErrorGrowth {
 public:
  using Jacobian = typename Pose::Jacobian;

  // `is_kept`: the pose itself is in the map now. `used`: so many of its loops are.
  void See(const SeenLoops<Pose>& seen, bool is_kept, int used, const Jacobian& link_covariance,
           const IncrementalSolver<Pose>& solver);
  // Enough was seen, or left out, since the last Growth() for another one.
  bool IsDue() const;
  // The logarithm of how many loops were seen over how many there were at the last Growth().
  double Passed() const;
  // The ratio of the root mean square position errors that the two maps expect, each laid over the truth as well as it
  // can be (aligned_error.h). Absent if one of them is singular. `is_link`: a factor is a loop.
  std::optional<double> Growth(const IncrementalSolver<Pose>& solver, const std::function<bool(FactorId)>& is_link);

  template <class Archive>
  void Serialize(Archive& archive);

 private:
  void Add(PoseId a, PoseId b, const UncertainPose<Pose>& T_a_b, double weight);

  // By the smaller id, then the larger one, in whose frame it is.
  std::map<std::pair<PoseId, PoseId>, Jacobian> information_;
  double evidence_ = 0, looked_at_ = 0;  // loops seen, and how many there were then
  double left_out_ = 0;                  // since then
  double tried_ = 1, measured_ = 1;      // registrations, and those that gave a link
};

// Tells `seen` of every registration. Empty if `registration` is; both must outlive it.
template <class Pose>
Registration<Pose> Watched(const Registration<Pose>& registration, SeenLoops<Pose>& seen);

}  // namespace terse
