// What of a pose graph is stored.

#include "terse/core/graph_members.h"

namespace terse {

// Gaps do not show: the living are stored.
template <class Pose>
template <class Archive>
void FactorList<Pose>::Serialize(Archive& archive) {
  std::vector<Node> living;
  if constexpr (!Archive::kReads) living.assign(begin(), end());
  archive(living);
  if constexpr (Archive::kReads) {
    *this = FactorList();
    for (const Node& node : living) {
      if (node.id.value < 0 || (!empty() && !(back().id < node.id))) archive.Fail("factor ids that do not ascend");
      Append(node.id, node.factor);
    }
  }
}

template <class Pose>
template <class Archive>
void PoseGraph<Pose>::Serialize(Archive& archive) {
  auto& [poses, index, factors, next_factor_id] = *this;
  archive.Each(poses, [&](PoseNode& node) {
    auto& [id, T_world_body, fixed] = node;
    archive(id, T_world_body, fixed);
  });
  archive(factors, next_factor_id);
  if constexpr (Archive::kReads) {
    index.clear();
    for (const PoseNode& node : poses) {
      if (!index.emplace(node.id.value, static_cast<int>(index.size())).second) archive.Fail("a pose comes twice");
    }
    for (const FactorNode& node : factors) {
      const FactorPoses ends = PosesOf(node.factor);
      if (!HasPose(ends.first) || !HasPose(ends.second)) archive.Fail("a factor on a pose that there is not");
      if (node.id.value >= next_factor_id) archive.Fail("a factor with an id that was not given out");
    }
  }
}

#define TERSE_INSTANTIATE(Pose)                           \
  template void PoseGraph<Pose>::Serialize(StateWriter&); \
  template void PoseGraph<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
