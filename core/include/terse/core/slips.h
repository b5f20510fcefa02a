#pragma once
// Odometry that fails: single measurements that are wrong by far, as where wheels slip or a front end loses track, to
// test what must survive them. The information stays what it was.

#include <cstdint>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse {

// Which of the steps between poses that arrive one after the other go wrong, and how. Same poses, count and seed, same
// slips, on every machine.
template <class Pose>
class Slips {
 public:
  // Throws std::invalid_argument if there are fewer steps than slips, or less than none are asked for.
  Slips(long poses, long count, std::uint64_t seed);

  // True if the step from pose place - 1 to `place`, in order of arrival, is one of them: then its measurement turns by
  // 10 to 60 degrees more than it did, about any axis (SE3), and goes 1 to 5 times its own length (or 0.1 m, if that is
  // more) elsewhere.
  bool Apply(long place, RelativePoseFactor<Pose>& odometry) const;

 private:
  std::vector<long> places_;  // ascending
  std::uint64_t seed_;
};

template <class Pose>
struct GraphWithSlips {
  PoseGraph<Pose> graph;
  std::vector<FactorId> slipped;  // in order of arrival
};

// The graph with its factors in order of arrival (arrival.h) and these slips among them: steps are the first factors
// between poses that arrive one right after the other. Throws std::invalid_argument as Slips does, and for a graph that
// is not connected.
template <class Pose>
GraphWithSlips<Pose> AddSlips(const PoseGraph<Pose>& graph, long count, std::uint64_t seed);

}  // namespace terse
