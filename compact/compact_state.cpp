// What of a compact run is stored: all but what the next step works out again to the same bits.

#include "compact_pose_slam_parts.h"
#include "fused_edges.h"
#include "terse/compact/state_members.h"
#include "terse/core/log_message.h"

namespace terse {

template <class Pose>
template <class Archive>
void CompactPoseSlam<Pose>::Serialize(Archive& archive) {
  auto& [options, most_innovation, most_distance, solver, marginals, gains, history, links, fused, refused, failed,
         searches, T_pose_base, reach, searched_version, searched_base] = *this;
  archive(options);
  if constexpr (Archive::kReads) TakeOptions(options);
  archive(*solver, *marginals, searches, *gains);
  archive.Each(links, [&](Link& link) {
    auto& [factor, added_at, gain] = link;
    archive(factor, added_at, gain);
  });
  archive(*history);
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
    const std::string defect = history->FindStateDefect(solver->Graph());
    if (!defect.empty()) archive.Fail(defect);
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
      if (solver->Graph().FindFactor(link.factor) == nullptr || !(HasSeen(link.added_at) || HasForgotten(link.added_at)))
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
