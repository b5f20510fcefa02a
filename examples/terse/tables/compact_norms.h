#pragma once
// Is compact pose SLAM conservative? Covariances of three systems over the same run (Ila et al. 2017 Fig. 6).

#include <string>
#include <vector>

#include "terse/compact/graph_replay.h"

namespace terse {

// Sums of variances, square metres and square radians, body frame: of the newest pose, and over the poses that FPFL has
// kept by then, the same ones in every system.
struct CovarianceNorms {
  double newest_position = 0, newest_rotation = 0, kept_position = 0, kept_rotation = 0;
};

// A row per step.
//  apal: all poses, all links.
//  marginalised: every pose comes with all its links to poses that are still there, and those that FPFL drops are then
//    taken out by Schur complement. So no information of theirs is lost, only what later links to them would add.
//    Computed without the Schur complement: it leaves the covariances of the others as they are, so these are those of
//    all poses with the links that end at kept poses. (If all links counted they would be apal's own.)
//  fpfl: the chosen poses and links. A dropped newest pose: its chain composed to the kept pose before it.
// The measurements of each are among those of the one before: at the same linearisation points the norms can only grow
// from apal to fpfl. Each system has its own points, its estimates.
struct NormPoint {
  int step = 0;  // poses seen
  CovarianceNorms apal, marginalised, fpfl;
};

// `fpfl`: the options of the compact run.
template <class Pose>
std::vector<NormPoint> ComputeNorms(const PoseGraph<Pose>& graph, const CompactOptions<Pose>& fpfl,
                                    const std::string& label, bool quiet);

}  // namespace terse
