#include "terse/compact/contradicted_loops.h"

#include <algorithm>
#include <cmath>

#include "terse/core/residual.h"
#include "terse/core/robust.h"

namespace terse {
namespace {

constexpr int kLeastRefused = 3;
constexpr double kDoubtfulShare = 0.02;
// Widths. True loops that gnc leaves out are seldom farther off, wrong ones, local ones too, in 99 of 100 cases.
constexpr double kByFar = 10;

template <class Pose>
std::vector<FactorId> LoopsBeyond(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body, double limit) {
  const auto value = [&](PoseId id) { return T_world_body[static_cast<std::size_t>(graph.IndexOf(id))]; };
  std::vector<FactorId> out;
  for (const FactorId id : LoopFactors(graph)) {
    const auto* loop = std::get_if<RelativePoseFactor<Pose>>(&graph.FindFactor(id)->factor);
    if (loop != nullptr && FactorChi2<Pose>(*loop, value(loop->from), value(loop->to)) > limit) out.push_back(id);
  }
  std::sort(out.begin(), out.end());
  return out;
}

// Of all poses, by their index in the graph.
template <class Pose>
std::vector<Pose> ValuesOf(const CompactPoseSlam<Pose>& slam, const PoseGraph<Pose>& graph) {
  std::vector<Pose> values(graph.Poses().size());
  for (const RecoveredPose<Pose>& pose : slam.Trajectory()) {
    values[static_cast<std::size_t>(graph.IndexOf(pose.id))] = pose.T_world_body;
  }
  return values;
}

}  // namespace

template <class Pose>
bool AreLoopsInDoubt(const CompactRun<Pose>& run) {
  return run.links_refused >= kLeastRefused && run.links_refused > kDoubtfulShare * run.links_offered;
}

template <class Pose>
std::vector<FactorId> ContradictedLoops(const PoseGraph<Pose>& graph, const CompactRun<Pose>& first,
                                        BatchOptions options) {
  options.robust = first.slam.Options().solver.robust;
  const BatchResult<Pose> whole = SolveBatch(graph, options);
  if (whole.weights.empty()) return {};
  const double limit = std::pow(kByFar * whole.robust_width, 2);
  std::vector<FactorId> by_whole = LoopsBeyond(graph, whole.T_world_body, limit);
  const std::vector<FactorId> by_first = LoopsBeyond(graph, ValuesOf(first.slam, graph), limit);
  return by_whole.size() < by_first.size() ? by_whole : std::vector<FactorId>();
}

template <class Pose>
PoseGraph<Pose> WithoutFactors(PoseGraph<Pose> graph, const std::vector<FactorId>& ids) {
  for (const FactorId id : ids) graph.RemoveFactor(id);
  return graph;
}

#define TERSE_INSTANTIATE(Pose)                                                                           \
  template bool AreLoopsInDoubt<Pose>(const CompactRun<Pose>&);                                           \
  template std::vector<FactorId> ContradictedLoops<Pose>(const PoseGraph<Pose>&, const CompactRun<Pose>&, \
                                                         BatchOptions);                                   \
  template PoseGraph<Pose> WithoutFactors<Pose>(PoseGraph<Pose>, const std::vector<FactorId>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
