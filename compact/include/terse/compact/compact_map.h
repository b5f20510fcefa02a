#pragma once
// A compact map as a plain value: what CompactPoseSlam::Export gives and Restore continues from.
//
// Estimates are those at the time of the export. Restore starts from them and brings the map to its optimum, so it
// continues as the run that was exported would have after Finish(), up to the tolerance of that (a step worth 1e-11 of
// chi2). (CompactPoseSlam::Save is for continuing to the last bit.) Options are not part of it.

#include <optional>
#include <string>
#include <vector>

#include "terse/compact/uncertain_pose.h"
#include "terse/core/pose_graph.h"

namespace terse {

template <class Pose>
struct CompactMap {
  // A pose as it was seen.
  struct SeenPose {
    PoseId id;
    bool kept = true;
    Pose T_world_body;            // of a dropped one as recovered
    Pose T_world_body_when_seen;  // Recovery::kV0
    // That its odometry comes from; absent for the first, and where it is forgotten.
    std::optional<PoseId> previous;
    PoseId base;                      // the kept pose that it hangs on; itself if kept
    UncertainPose<Pose> T_base_pose;  // identity, without covariance, if kept
    // Of a dropped one, once its chain has ended at another kept pose.
    std::optional<PoseId> next_kept;
    UncertainPose<Pose> T_base_next;
    // Of a dropped one whose chain starts with a link of its own: the pose that the link leads to. It hangs where that
    // one does.
    std::optional<PoseId> anchored_to;
    // Of one whose chain a link has ended: the pose that was anchored so. Absent if odometry did.
    std::optional<PoseId> ended_by;
    bool carried = false;  // the chain has served to carry a loop to its base
  };
  // One of the measurements that make an edge together.
  struct Part {
    FactorId id;      // CompactPoseSlam::RemoveLink takes it; -1 of several that are one by now
    PoseId added_at;  // the pose at whose step it came in, or that retired and left it (retire_poses.h)
    double gain = 0;  // nats; of odometry, and of what a retired pose left, 0
    // Composed: where its links lead to from that pose; one link goes with the pose's chain. Left by a retired pose:
    // its two neighbours.
    std::vector<PoseId> links;
    UncertainPose<Pose> T_from_to;  // from the smaller id of the edge's ends to the larger
    long measurements = 1;
  };
  struct Edge {
    FactorId factor;
    RelativePoseFactor<Pose> measured;
    bool is_loop = false;        // a link beside the odometry
    PoseId added_at;             // the pose at whose step it came in
    std::optional<double> gain;  // nats; of links that were tested
    // Odometry over dropped poses: those whose measurements were concatenated, from kept pose to kept pose. Of a link
    // that a pose left which retired (retire_poses.h), in what RetirePoses returns: the pose between its ends; a run
    // that continues has it in `parts`, as what links of that pose compose. Else empty.
    std::vector<PoseId> composed_of;
    // Where several measurements make the edge, or links composed it: these, oldest first. Else empty.
    std::vector<Part> parts;
  };
  struct Prior {
    FactorId factor;
    Factor<Pose> measured;
  };
  struct Fixed {
    PoseId pose;
    Pose T_world_body;  // where it is held
  };
  // A link that the innovation test refused; others may agree with it (CompactOptions::consensus).
  struct Refused {
    PoseId candidate, seen;
    UncertainPose<Pose> T_candidate_seen;
  };
  // A registration that failed: its neighbours are not tried again at once.
  struct Failed {
    PoseId candidate, seen;
  };
  std::vector<SeenPose> poses;  // in order of arrival
  // So many more were dropped and are forgotten (CompactOptions::most_dropped); ids then ascend, and others name them
  // where they came in with them (added_at, links).
  long forgotten = 0;
  std::vector<Edge> edges;    // between kept poses, ascending factors
  std::vector<Prior> priors;  // on kept poses
  std::vector<Fixed> fixed;
  std::vector<Refused> refused;  // oldest first
  std::vector<Failed> failed;    // likewise
};

// What contradicts itself in a map and where, as "poses[3].base: ...", else empty. That measurements hold all poses is
// for the solver to find out.
template <class Pose>
std::string FindDefect(const CompactMap<Pose>& map);

}  // namespace terse
