#pragma once
// Edges of the map that several measurements make (bounded_step.h composes them): they come to the solver, and can be
// taken out again one by one.

#include <optional>
#include <vector>

#include "compact_parts.h"

namespace terse::internal {

// Composed of measurements, between kept poses.
template <class Pose>
struct NewEdge {
  PoseId a, b;
  UncertainPose<Pose> T_a_b;
  double gain = 0;            // about the map, nats
  std::vector<int> offers;    // in CurrentPose::offers; one: with the chain from a
  std::vector<PoseId> links;  // where they lead to as measured
  FactorId id = {};
  bool fused = false;  // with an edge that was there
};

// Whether an edge joins the two that others can fuse with.
template <class Pose>
bool IsJoined(PoseId a, PoseId b, const CompactParts<Pose>& parts);

// What an edge between the two must tell the map, nats: nearly nothing if it fuses with one that is there.
template <class Pose>
double LeastEdgeGain(PoseId a, PoseId b, const CompactParts<Pose>& parts);

// In one update; their ids, and which were fused. Those between the same two poses fuse with each other too. Throws
// NumericalError, and changes nothing, if the map has no solution with them.
template <class Pose>
void AddEdges(PoseId added_at, std::vector<NewEdge<Pose>>& edges, CompactParts<Pose>& parts,
              std::optional<StepReport>& report);

// As CompactPoseSlam documents it.
template <class Pose>
void RemoveLink(FactorId id, CompactParts<Pose>& parts);

}  // namespace terse::internal
