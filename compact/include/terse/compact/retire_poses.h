#pragma once
// Poses that a map can do without retire: they are marginalised into factors between their neighbours, and are dropped
// poses from then on.
//
// A kept pose may retire where the area was mapped more densely than needed: a neighbour within the sensor range knows
// it so well that a link would add no more than min_pose_gain, the test by which FPFL drops a pose on arrival. That
// neighbour has to know as well those that retired in favour of the pose (the eight farthest of them): whatever ground
// was covered stays so.
//
// All that the factors at a pose p say of its neighbours is the joint distribution of their displacements. It is
// replaced by one relative pose per edge of a spanning tree over the neighbours, the tree that loses least (Chow and
// Liu, 1968), each with its exact covariance, as in generic linear constraints (Carlevaris-Bianco, Kaess, Eustice,
// IEEE T-RO 2014) and nonlinear factor recovery (Mazuran, Burgard, Tipaldi, IJRR 2016). All of these covariances are
// then scaled by the least factor that leaves the tree nowhere surer than the factors were: the covariances of what
// remains never shrink. With one or two neighbours nothing is lost. The means are such that the optimum of the map
// stays where it is, to first order: retiring moves nothing. Where measurements disagree with the map by more than
// their covariances say that is no order to go by, and poses stay.
//
// What a retired pose is reached by, the odometry from the kept pose before it, is its chain then; where this odometry
// leads on to another kept pose, that one's odometry leads over the retired pose. Where other factors went with it the
// chain holds, instead of the odometry, where the map has the pose and how well it knows it: nothing is carried along
// such a chain any more, and the pose stays where those factors had put it.

#include <vector>

#include "terse/compact/compact_map.h"
#include "terse/compact/compact_options.h"
#include "terse/compact/decision.h"

namespace terse {

struct RetireOptions {
  double most_loss = 1;     // nats that the removal of one pose may lose; 0 or more
  int most_neighbours = 4;  // that a pose may have which retires; at least 1
  // With a robust kernel that weighs loops the weight of a loop is its own: poses that loops hang on stay then.
  bool only_odometry = false;
  // What is new has these ids or, of factors, higher, of parts, lower ones: those between may have been others'.
  FactorId first_factor = {0}, first_part = {-2};
  int least_kept = 0;  // poses, at which it ends
  // Loops that a kernel leaves out: they say nothing, and the poses that they hang on stay. Ascending.
  std::vector<FactorId> left_out = {};
};

template <class Pose>
struct Retired {
  CompactMap<Pose> map;
  std::vector<RetiredPose> poses;  // in the order in which they retired
};

// Least loss first; a pose that retires makes its neighbours be looked at again. Of `options` the thresholds (range,
// probability, min_pose_gain, link_covariance), the angle of distances and the order of composition count. The map is
// taken to be at its optimum. The first pose stays, as do fixed ones, those with priors, the one that the newest pose
// hangs on, and one that the odometry of several others comes from. Where an edge joins two neighbours already the two
// become one. Estimates stay, those of retired poses too; CompactPoseSlam::Restore recovers these anew. Factors that
// are new have ids above all others. O(log n) a pose for the covariances that it asks for and for the order, after one
// factorisation of the map. Throws std::invalid_argument if the map contradicts itself or an option is out of its
// domain, NumericalError if the map's measurements do not hold it.
template <class Pose>
Retired<Pose> RetirePoses(const CompactMap<Pose>& map, const CompactOptions<Pose>& options,
                          const RetireOptions& retire = {});

}  // namespace terse
