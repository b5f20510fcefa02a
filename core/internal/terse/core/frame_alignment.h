#pragma once
// The rigid motion that lays a map over its absolute measurements. Private to the library.

#include <optional>
#include <utility>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// T_new_old with the least sum of chi2 of the absolute measurements (pose and position priors) at T_new_old *
// T_old_body, each given with its pose; relative ones do not matter. Turns of which the measurements know less than
// kLeastTurnInformation stay as they are, but for rounding. nullopt if no motion is better than none by more than
// rounding. A least-squares fit of points and rotations, refined by Gauss-Newton on the motion.
template <class Pose>
std::optional<Pose> AlignToAbsolute(const std::vector<std::pair<Factor<Pose>, Pose>>& measurements);

// Points of the old frame, where they are in the new one, and how much each counts, 1 / m^2.
template <class Pose>
struct WeightedPoints {
  std::vector<typename Pose::Position> old_frame, new_frame;
  std::vector<double> weights;
};
// The motion that minimises the weighted squared distances of points [first, last) plus `preference` (1 / rad^2) times
// the squared chordal distance of its rotation from that of `T_preferred`, which so decides what the points leave open.
template <class Pose>
Pose FitPoints(const WeightedPoints<Pose>& points, std::size_t first, std::size_t last, const Pose& T_preferred,
               double preference);

}  // namespace terse::internal
