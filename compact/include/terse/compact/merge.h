#pragma once
// Maps of several sessions or robots as one. Where each lies in the frame of the others is unknown; links between them
// say so, some of which may be wrong, or absolute measurements (GNSS) do.
//
//     const std::vector<MapToMerge<SE2>> maps = {{"a", a}, {"b", b}};  // CompactMap; MapOfGraph makes one of a graph
//     const Merged<SE2> joint = Merge(maps, ReadMapLinks("links.txt", maps));  // map_links.h
//     auto slam = CompactPoseSlam<SE2>::Restore(joint.map, options);  // the robot of maps[0] goes on
//
// 1. Each map is brought to its optimum. Loops of its own that it contradicts there stay out, as its kernel had it.
// 2. Two maps: a pair of links closes a cycle through both. Links that pairwise agree, within the covariances of the
//    cycle, hold the two maps together: the largest such set that is found (PCM: Mangelson, Dominic, Eustice,
//    Vasudevan, ICRA 2018), if no other set without a link of it is as large. A single link that nothing confirms
//    counts only where there is no other between its maps, and holds them only where nothing else does.
// 3. Maps are put together along a spanning tree, the largest sets first. Maps whose absolute measurements determine
//    where they lie in the world need no links.
// 4. All other links are tested against the joint optimum, with covariances across maps, those that agree come in, and
//    truncated least squares over all links has the last word.
// 5. Poses retire where the joint map is denser than needed (retire_poses.h).
//
// Ids: maps[0] keeps its own. Those of the others are moved where maps use the same ones (PlacedMap::id_offset). A run
// that forgets dropped poses goes on doing so only in a joint map whose ids ascend: MapToMerge::id_offset below zero.
// Deterministic. Memory and time grow with poses and links, but for the comparison of pairs, which takes so many links
// of two maps at most.

#include <optional>
#include <string>
#include <vector>

#include "terse/compact/compact_map.h"
#include "terse/compact/compact_options.h"
#include "terse/compact/decision.h"

namespace terse {

template <class Pose>
struct MapToMerge {
  std::string name;  // for messages
  CompactMap<Pose> map;
  // What is added to its ids; absent: chosen so that no two maps have the same.
  std::optional<std::int64_t> id_offset = {};
};

// Between two maps: measured.from is a pose of maps[from_map], by the id that it has there. Poses that the map has
// dropped will do: the link is carried to the kept pose that they hang on.
template <class Pose>
struct MapLink {
  int from_map = 0, to_map = 0;
  RelativePoseFactor<Pose> measured;
};

enum class MapLinkVerdict {
  kAccepted,      // in the joint map
  kInconsistent,  // contradicts it, or what pairwise agrees
  kMapsApart,     // between maps of which one has not been joined
};
const char* Name(MapLinkVerdict verdict);

template <class Pose>
struct MergedLink {
  MapLink<Pose> link;  // as it was given
  PoseId from, to;     // in the joint map, kept poses
  MapLinkVerdict verdict = MapLinkVerdict::kMapsApart;
  int agreeing = -1;      // of the links that it was compared with in pairs; -1: it was not
  double innovation = 0;  // squared Mahalanobis distance from the joint map without it; if accepted, of what is left
};

// What holds a map in the joint frame.
enum class Placement {
  kReference,    // the joint frame is its own
  kLinks,        // links that agree
  kUnconfirmed,  // one link, which nothing confirms or contradicts
  kDatum,        // absolute measurements
  kApart,        // nothing: it is not part of the joint map
};
const char* Name(Placement placement);

template <class Pose>
struct PlacedMap {
  std::string name;
  std::int64_t id_offset = 0;  // joint id less own id
  Placement placement = Placement::kApart;
  // Where the map's own frame, that of its own optimum, came to lie: by its first kept pose.
  Pose T_joint_map;
  // Of that pose, body frame: relative to the first pose of the reference map, or absolute if absolute measurements
  // determine where the joint map is.
  typename Pose::Jacobian covariance = Pose::Jacobian::Zero();
  int poses = 0;      // that came with it
  int kept = 0;       // of these in the joint map
  int loops_out = 0;  // of its own that its optimum contradicts
};

template <class Pose>
struct MergeOptions {
  double pair_quantile = 0.99;    // of the chi-square distribution: two links that disagree by more do not agree
  double link_quantile = 0.9999;  // likewise, of a link and the joint map
  // Links of two maps that are compared in pairs, at most; spread over all.
  int most_compared = 200;
  // Nats that a retiring pose may lose, as a share of the least gain of a link (CompactOptions::retire_share); 0: none
  // retire.
  double retire_share = 0.3;
  // By which a pose is near another; absent: SelectThresholds of the joint graph.
  std::optional<Thresholds<Pose>> thresholds;
  int threads = 1;  // at most; the result is the same for any number
};

template <class Pose>
struct Merged {
  PoseGraph<Pose> graph;                // kept poses and all that is measured, at the optimum; covariances cross maps
  CompactMap<Pose> map;                 // the same with the dropped poses; those of maps[0] come last
  std::vector<PlacedMap<Pose>> maps;    // in the order given
  std::vector<MergedLink<Pose>> links;  // likewise
  std::vector<RetiredPose> retired;     // in the order in which they went
  int poses_before = 0;                 // kept, before poses retired
  Thresholds<Pose> thresholds;          // that poses retired by, and for a run that goes on
  double chi2 = 0;                      // of `graph`
  double chi2_before = 0;               // before poses retired
};

// A graph as a map at its optimum, all its poses kept. Throws std::invalid_argument if it is empty or not connected,
// NumericalError if it has no optimum.
template <class Pose>
CompactMap<Pose> MapOfGraph(const PoseGraph<Pose>& graph, int threads = 1);

// Maps that nothing holds to the largest group stay apart (of groups as large that of maps[0]). Throws
// std::invalid_argument if there are fewer than two maps, a map contradicts itself or has no kept pose, a link names a
// map or pose that there is not or is defective, an option is out of its domain, or ids are the same as moved or leave
// 64 bits; NumericalError if no two maps hold together, or if a map has no optimum.
template <class Pose>
Merged<Pose> Merge(const std::vector<MapToMerge<Pose>>& maps, const std::vector<MapLink<Pose>>& links,
                   const MergeOptions<Pose>& options = {});

}  // namespace terse
