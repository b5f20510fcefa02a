#pragma once
// A run whose loops are looked at here and there: what SelectThresholds chooses by.
//
// All poses come, but of a pose's links only a few join the map, each with the information of those that it stands for.
// So it knows about what one with all links knows, at a bounded number of links per pose. They are those to the poses
// of the lowest ranks, which are as if drawn at random: so poses that lie together link to the same few, and the factor
// stays sparse where a robot passes often. Poses that are not looked at join the map in blocks.

#include <limits>
#include <random>
#include <vector>

#include "loop_gains.h"
#include "terse/compact/thresholds.h"

namespace terse {

template <class Pose>
class Sample {
 public:
  using Jacobian = typename Pose::Jacobian;
  // Of a pose, at most: loops looked at, links in the map.
  static constexpr int kMostLoops = 12, kMostLinks = 4;

  // Refers to the replay.
  Sample(const SampleOptions& options, GraphReplay<Pose>& replay);

  // In order of arrival. A pose that is looked at tells what its loops would tell the map as it is.
  void Add(const CompactInput<Pose>& input, bool look);

  std::vector<double> loop_gains, pose_gains;
  long loops_seen = 0, links = 0;                  // looked at; in the map
  long refused = 0;                                // that were to join it
  std::vector<RelativePoseFactor<Pose>> believed;  // those in the map, as they were measured

 private:
  using Link = RelativePoseFactor<Pose>;
  struct Pending {
    const CompactInput<Pose>* input;
    UncertainPose<Pose> T_previous_pose, T_root_pose;
    std::vector<Link> links;
    double share = 1;  // of the links offered, those that were drawn
  };
  struct Drawn {
    std::vector<Link> seen, joining;
  };

  Drawn Draw(const CompactInput<Pose>& input, bool look);
  void Look(const Pending& pose, const std::vector<Link>& loops);
  void RemoveRefused(std::size_t index);
  void Flush();
  bool IsTested() const { return most_innovation_ < std::numeric_limits<double>::infinity(); }

  const double most_innovation_;
  const Jacobian Sigma_y_;
  Registration<Pose> registration_;
  std::mt19937_64 engine_{1};
  IncrementalSolver<Pose> solver_;
  IncrementalMarginals<Pose> marginals_;
  PoseId root_;                   // in the map: the first pending pose's odometry comes from it
  std::vector<Pending> pending_;  // a chain
};

extern template class Sample<SE2>;
extern template class Sample<SE3>;

}  // namespace terse
