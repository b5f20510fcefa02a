#pragma once
// Measurements of dropped poses as measurements of the kept poses that these hang on: composed with the chains between,
// whose covariances add to their own. (A chain's error is counted in the map's odometry as well; the two are taken as
// independent.)

#include "pose_history.h"
#include "terse/core/incremental_solver.h"

namespace terse::internal {

// Both throw std::invalid_argument for a defective link or an unknown end. An end that is kept, or that is not asked
// for, stays.
template <class Pose>
RelativePoseFactor<Pose> CarryToKept(const RelativePoseFactor<Pose>& link, const PoseHistory<Pose>& history,
                                     CompositionOrder order);
template <class Pose>
RelativePoseFactor<Pose> CarryEndToKept(PoseId end, const RelativePoseFactor<Pose>& link,
                                        const PoseHistory<Pose>& history, CompositionOrder order);
// Throws std::invalid_argument for a link, a defective prior or an unknown pose.
template <class Pose>
Factor<Pose> CarryPriorToKept(const Factor<Pose>& prior, const PoseHistory<Pose>& history,
                              const IncrementalSolver<Pose>& solver, CompositionOrder order);

}  // namespace terse::internal
