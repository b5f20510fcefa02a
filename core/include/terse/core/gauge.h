#pragma once
// What fixes the gauge of a pose graph.
//
// Relative measurements leave the frame of the map free. A proximal anchor on the first pose fixes it: information on
// that pose's tangent directions with zero residual at whatever value the pose has, so it never enters chi2
// and never biases the optimum. Absolute measurements (pose and position priors, FIXed poses) take its place as far as
// they determine how the map as a whole lies: the rigid motions of the map about which they hold less than the least
// information below stay with the anchor. One position prior determines where the map is and leaves every turn about it
// to the anchor, two leave the turn about their line (3D). What the anchor holds is a choice of coordinates: relative
// covariances do not depend on it, and absolute ones are relative to the first pose in those directions.
//
// The alternative, a very weak anchor on what nothing measures, makes covariances of 30 rad and thousands of metres,
// out of which every relative covariance would have to be told to the millimetre.

#include <string>
#include <vector>

#include "terse/core/linear_factor.h"

namespace terse {

// 0.1 mm and 0.1 mrad: nothing beside any measurement, and far from the limits of double precision.
inline constexpr double kAnchorInformation = 1e8;
// 30 rad, on the turns that position priors determine: for a part of the graph that they do not reach.
inline constexpr double kWeakAnchorInformation = 1e-3;
// 1 km and 1 rad: what is known less well than this is not determined.
inline constexpr double kLeastPositionInformation = 1e-6;
inline constexpr double kLeastTurnInformation = 1;

struct AbsoluteFactors {
  int pose_priors = 0;  // FIXed poses count as such
  int position_priors = 0;
  int Count() const { return pose_priors + position_priors; }
};

template <class Pose>
AbsoluteFactors CountAbsoluteFactors(const PoseGraph<Pose>& graph);

// What the anchor on the first pose holds.
template <class Pose>
struct Gauge {
  static constexpr int kTurns = Pose::kDof - Pose::kDim;
  using Root = Matrix<Pose::kDof, Pose::kDof>;
  // Independent directions in which no absolute measurement determines where the map is, or how it is turned.
  int free_shifts = Pose::kDim, free_turns = kTurns;
  // Symmetric root of the anchor's information, in tangent directions of the first pose: the identity times the root
  // of kAnchorInformation where everything is free.
  Root root = Root::Identity() * 1e4;

  bool IsDetermined() const { return free_shifts == 0 && free_turns == 0; }
};

// Information of absolute measurements about rigid motions of a map: summed at the poses' values, whatever the
// measured values are. Not thread-safe.
template <class Pose>
class AbsoluteInformation {
 public:
  // Relative factors add nothing.
  void Add(const Factor<Pose>& factor, const Pose& T_world_body);
  Gauge<Pose> FindGauge(const Pose& T_world_first) const;

 private:
  static constexpr int B = Pose::kDof;
  bool any_ = false, any_pose_prior_ = false;
  typename Pose::Position centre_;                   // the first measured position
  Matrix<B, B> information_ = Matrix<B, B>::Zero();  // of a motion Exp(xi) about the centre, xi = [rho; phi]
};

// The gauge of a graph at given values, by pose index: O(factors).
template <class Pose>
Gauge<Pose> FindGauge(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body);

// On the first pose.
template <class Pose>
LinearFactor<Pose::kDof> Anchor(const Gauge<Pose>& gauge);

// What the absolute measurements, some of which there are, leave undetermined, in words, as in "heading is not
// determined by the priors yet: ..."; "" if they determine everything.
template <class Pose>
std::string DescribeUndetermined(const Gauge<Pose>& gauge, const Pose& T_world_first);
// The same for a whole graph; "" too without absolute measurements, where the frame is the first pose's by definition.
template <class Pose>
std::string DescribeUndetermined(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body);

// A FIXed pose is held at its value by this prior, which is not counted in chi2.
template <class Pose>
PosePriorFactor<Pose> FixedPosePrior(PoseId id, const Pose& T_world_body);

}  // namespace terse
