#pragma once
// Loops that others near them bear out.
//
// Two true loops from about one place to about one other place close a cycle over short stretches of odometry, and it
// closes; a wrong loop seldom has a neighbour that is wrong in the same way (pairwise consistency: Mangelson et al.,
// ICRA 2018). A true loop that is alone has none either: without support is not wrong.

#include <cstddef>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::internal {

// Loops (robust.h) that agree with none of the others, up to 32 of them, whose ends lie within ten poses of theirs,
// ascending. O((V + E) log V), and all that lie near where many do.
template <class Pose>
std::vector<FactorId> UnsupportedLoops(const PoseGraph<Pose>& graph);

// Whether these are wrong loops rather than true ones that stand alone by chance.
struct LoopSupport {
  std::vector<FactorId> unsupported;
  std::size_t loops = 0;  // of how many
  // More than one in ten is unsupported, and odometry alone contradicts half of them more than twice as much as it
  // contradicts half of the others, whatever the scale of the information; or more than one in three, where odometry
  // may know too little to contradict any.
  bool are_suspect = false;
  // Median squared error by odometry alone, of the unsupported over that of the others; 0 where there is none of
  // either.
  double alone_over_others = 0;
  // The others can do without them: there is one for every four poses.
  bool others_are_many = false;
};
template <class Pose>
LoopSupport FindSupport(const PoseGraph<Pose>& graph);

}  // namespace terse::internal
