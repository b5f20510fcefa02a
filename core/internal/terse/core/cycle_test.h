#pragma once
// Loops that odometry alone contradicts, whatever the map was made to believe before.
//
// Where covariances are too cautious by orders of magnitude (identity information: a metre and a radian for every
// edge), the first wrong loops bend the map at no cost, and true ones then look no better. The cycle that a loop closes
// with the odometry between its ends does not depend on what is believed. Most loops are true: the median of their
// innovations says how good odometry really is (innovation_scale.h), and a loop far above that is wrong, or leads over
// odometry that is.

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <limits>
#include <map>
#include <optional>
#include <vector>

#include "terse/core/innovation_scale.h"
#include "terse/core/pose_graph.h"

namespace terse::internal {

template <class Pose>
class CycleTest {
 public:
  using Covariance = typename Pose::Jacobian;

  // Odometry brings a pose in. From another pose than the newest one it begins a chain.
  void Extend(const RelativePoseFactor<Pose>& odometry);
  PoseId Newest() const { return newest_; }
  // The newest pose did not come in; the one before.
  void Retract(PoseId before) {
    links_.erase(newest_);
    newest_ = before;
  }
  // The odometry that brought this pose in is wrong: no cycle leads over it. O(n), of the newest pose O(log n).
  void Break(PoseId pose);
  // Poses that are not there any more, but the newest. Amortised O(log n) a pose.
  template <class Test>
  void Forget(const Test& is_there) {
    if (links_.size() < 2 * size_when_swept_ + kLeastSweep) return;
    for (auto it = links_.begin(); it != links_.end();) {
      it = it->first == newest_ || is_there(it->first) ? std::next(it) : links_.erase(it);
    }
    size_when_swept_ = links_.size();
  }

  // Squared, of a loop with this covariance of T_from_to in the tangent space of `to`; nothing if no odometry leads
  // from one of its ends to the other.
  std::optional<double> Innovation(PoseId from, PoseId to, const Pose& T_from_to, const Covariance& covariance) const;
  std::optional<double> Innovation(const RelativePoseFactor<Pose>& loop) const;

  // That of a loop that came; `stated`: the limit by the covariances as they are.
  void Note(double innovation, double stated) {
    if (innovation <= stated) scale_.Add(innovation);
    stated_ = stated;
    limit_ = scale_.Limit(stated, Pose::kDof);
  }
  // Drift that is not noise adds up with the length of a cycle, so the test is for where covariances say nothing.
  bool IsActive() const { return limit_ < kTooCautious * stated_; }
  double Limit() const { return limit_; }
  // Of an innovation against the map. Loops hold that more tightly than odometry does, but never believe it so well.
  double LimitInMap() const {
    if (!IsActive()) return std::numeric_limits<double>::infinity();
    return std::max(kReserveInMap * limit_, kLeastShareInMap * stated_);
  }
  bool Refuses(std::optional<double> innovation) const { return IsActive() && innovation && *innovation > limit_; }

  template <class Archive>
  void Serialize(Archive& archive) {
    auto& [links, newest, chains, arrivals, size_when_swept, scale, stated, limit] = *this;
    archive(links, newest, chains, arrivals, size_when_swept, scale, stated, limit);
  }

 private:
  // Limits below this share of the stated one; nobody's odometry is better than this share of its variance.
  static constexpr double kTooCautious = 0.1, kLeastShare = 1e-6;
  // Times the limit of cycles; and the least
  // share of the stated limit, as in innovation_scale.h.
  static constexpr double kReserveInMap = 50, kLeastShareInMap = 1e-3;
  static constexpr std::size_t kLeastSweep = 1000;
  // What odometry composes to from the first pose of the chain on, and its covariance, moved to that pose by the
  // adjoint: what lies between two poses is the difference of theirs.
  struct Link {
    Pose T_start_pose;
    Covariance covariance;
    std::int64_t chain, arrival;

    template <class Archive>
    void Serialize(Archive& archive) {
      archive(T_start_pose, covariance, chain, arrival);
    }
  };
  void Append(PoseId from, PoseId to, const Pose& T_from_to, const Covariance& covariance);
  std::map<PoseId, Link> links_;
  PoseId newest_;
  std::int64_t chains_ = 0, arrivals_ = 0;
  std::size_t size_when_swept_ = 0;
  InnovationScale scale_{kLeastShare};
  double stated_ = 0, limit_ = 0;
};

}  // namespace terse::internal
