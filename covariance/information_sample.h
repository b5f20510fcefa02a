#pragma once
// The beginning of a graph, out of which scales of its information are estimated.

#include <vector>

#include "terse/covariance/information_probe.h"
#include "terse/covariance/information_scale.h"

namespace terse::internal {

// The beginning of a graph, its relative factors only. Factor k of the graph is term k.
template <class Pose>
struct InformationSample {
  PoseGraph<Pose> graph;
  std::vector<ProbeTerm<Pose>> terms;
  std::vector<char> is_loop;
  long loops = 0;
};

template <class Pose>
InformationSample<Pose> TakeSample(const PoseGraph<Pose>& graph, const EstimateOptions& options);

// Each loop against the odometry alone, so that wrong ones do not matter to the others: in exponential coordinates what
// a long chain knows is normal too.
template <class Pose>
double ShareOfAgreeingLoops(const InformationSample<Pose>& sample);

}  // namespace terse::internal
