// What of a compact run is stored: all but what the next step works out again to the same bits.

#include <algorithm>

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"
#include "terse/compact/state_members.h"
#include "terse/core/at.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::At;

}  // namespace

template <class Pose>
template <class Archive>
void CompactPoseSlam<Pose>::Serialize(Archive& archive) {
  auto& [options, most_innovation, most_distance, solver, marginals, gains, history, index, links, fused, refused,
         failed, searches, T_pose_base, reach, searched_version, searched_base] = *this;
  archive(options);
  if constexpr (Archive::kReads) TakeOptions(options);
  archive(*solver, *marginals, searches, *gains);
  archive.Each(links, [&](Link& link) {
    auto& [factor, added_at, gain] = link;
    archive(factor, added_at, gain);
  });
  archive.Each(history, [&](Seen& seen) {
    auto& [id, base, T_base_pose, T_world_body_when_seen, previous, parent, successors, kept, anchored, next_kept,
           T_base_next, ended_by, stretch, carried, odometry] = seen;
    archive(id, base, T_base_pose, T_world_body_when_seen, previous, parent, successors, kept, anchored, next_kept,
            T_base_next, ended_by, stretch, carried, odometry);
  });
  archive(*fused);
  archive.Each(refused, [&](Refused& link) {
    auto& [candidate, seen, T_candidate_seen] = link;
    archive(candidate, seen, T_candidate_seen);
  });
  archive.Each(failed, [&](Failed& registration) {
    auto& [candidate, seen] = registration;
    archive(candidate, seen);
  });
  if constexpr (Archive::kReads) {
    index.clear();
    std::vector<int> successors_of(history.size(), 0);
    for (const Seen& seen : history) {
      const int at = static_cast<int>(index.size());
      const bool is_known = solver->Graph().HasPose(seen.base) && seen.kept == (seen.id == seen.base) &&
                            (!seen.next_kept || solver->Graph().HasPose(*seen.next_kept));
      const bool has_chain = seen.previous < at && (seen.previous < 0) == (at == 0) && seen.parent < at &&
                             (seen.parent < 0) == (at == 0) && (seen.anchored || seen.parent == seen.previous);
      const int poses = static_cast<int>(history.size());
      const bool has_end = seen.ended_by < poses && (seen.ended_by < 0 || history[At(seen.ended_by)].anchored);
      if (!is_known || !has_chain || !has_end) archive.Fail("a pose without its chain");
      // A dropped pose hangs where the one before it on its chain does; so chains end at a kept pose.
      const auto before = static_cast<std::size_t>(std::max(seen.parent, 0));
      if (!seen.kept && (at == 0 || history[before].base != seen.base)) archive.Fail("a pose without its chain");
      if (seen.stretch != (seen.kept ? -1 : StretchBehind(seen.parent, seen.anchored, at)))
        archive.Fail("a pose without its chain");
      if (at > 0) ++successors_of[before];
      if (!index.emplace(seen.id.value, at).second) archive.Fail("a pose comes twice");
    }
    for (std::size_t k = 0; k < history.size(); ++k) {
      if (history[k].successors != successors_of[k]) archive.Fail("a pose with another number of successors");
    }
    for (const Refused& link : refused) {
      if (!solver->Graph().HasPose(link.candidate) || !HasSeen(link.seen)) archive.Fail("a link of unknown poses");
    }
    for (const Failed& registration : failed) {
      if (!solver->Graph().HasPose(registration.candidate) || !HasSeen(registration.seen))
        archive.Fail("a registration of unknown poses");
    }
    for (const auto& [ends, edge] : fused->All()) {
      const FactorNode<Pose>* node = solver->Graph().FindFactor(edge.factor);
      const FactorPoses joined = node != nullptr ? PosesOf(node->factor) : FactorPoses();
      if (joined.count != 2 || FusedEdges<Pose>::Ordered(joined.first, joined.second) != ends)
        archive.Fail("an edge that is not in the map");
    }
    for (const Link& link : links) {
      if (solver->Graph().FindFactor(link.factor) == nullptr || !HasSeen(link.added_at))
        archive.Fail("a link that is not in the map");
    }
  }
}

template <class Pose>
void CompactPoseSlam<Pose>::Save(const std::string& path) const {
  SaveState(path, StateKind<Pose>("compact pose SLAM"), *this);
}

template <class Pose>
CompactPoseSlam<Pose> CompactPoseSlam<Pose>::Load(const std::string& path, LogSink log) {
  CompactPoseSlam slam = LoadState<CompactPoseSlam>(path, StateKind<Pose>("compact pose SLAM"));
  slam.SetLog(std::move(log));
  internal::Log(slam.options_.log, LogLevel::kInfo, "restored from ", path, ": ", slam.PosesSeen(), " poses seen, ",
                slam.solver_->Graph().Poses().size(), " kept, ", slam.LinksKept(), " links");
  return slam;
}

#define TERSE_INSTANTIATE(Pose)                                        \
  template void CompactPoseSlam<Pose>::Serialize(StateWriter&);        \
  template void CompactPoseSlam<Pose>::Serialize(StateReader&);        \
  template void CompactPoseSlam<Pose>::Save(const std::string&) const; \
  template CompactPoseSlam<Pose> CompactPoseSlam<Pose>::Load(const std::string&, LogSink);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
