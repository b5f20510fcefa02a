#pragma once
// Links between two maps whose place relative to each other is unknown: which of them agree in pairs. Link (i, j) and
// link (k, l) close a cycle i, k, l, j through both maps, whose covariance is that of the two links and of what either
// map knows of its part (PCM: Mangelson, Dominic, Eustice, Vasudevan, ICRA 2018, Eq. 5).

#include <vector>

#include "terse/compact/uncertain_pose.h"
#include "terse/covariance/pose_marginals.h"

namespace terse::internal {

// Between kept poses of a map a and a map b.
template <class Pose>
struct InterMapLink {
  PoseId in_a, in_b;
  UncertainPose<Pose> T_a_b;  // of the two poses
};

struct AgreeingLinks {
  std::vector<int> members;   // by position in what was asked, ascending; each agrees with each other
  std::vector<int> agreeing;  // with how many of those compared; -1: was not compared
  int rival = 0;              // the size of the largest set that was found without any of these
  // Of a limit on squared innovations that covariances as stated lead to, the share that links need.
  double limit_share = 1;
};

// The values at which the marginals are, by pose.
template <class Pose>
struct MapKnowledge {
  const PoseMarginals<Pose>* marginals;
  const PoseGraph<Pose>* graph;  // at its optimum
};

// Two agree if the squared distance is within this quantile of its chi-square distribution. Where covariances are too
// cautious links agree that lead anywhere; but the right ones go on agreeing far below that limit, and it shrinks to
// four times the least at which a set half as large is left (down to a hundred-thousandth). At most `most_compared`
// links are compared, spread over all. O(most_compared^2) and one joint covariance of their poses in either map. The
// largest set is searched for greedily, from the links that agree with most.
template <class Pose>
AgreeingLinks FindAgreeing(const std::vector<InterMapLink<Pose>>& links, const MapKnowledge<Pose>& a,
                           const MapKnowledge<Pose>& b, double quantile, int most_compared);

// Of an undirected graph, agrees[i][j] != 0: a set of vertices of which each is joined to each other, ascending.
// Vertices with allowed[i] == 0 are left out. Greedy from every vertex that may be in a larger set, and exact where the
// graph is one such set and isolated vertices.
std::vector<int> LargeClique(const std::vector<std::vector<char>>& agrees, const std::vector<char>& allowed);

}  // namespace terse::internal
