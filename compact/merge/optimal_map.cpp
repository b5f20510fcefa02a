#include "merge/optimal_map.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "map_graph.h"
#include "sparsify/dropped_poses.h"
#include "terse/compact/merge.h"
#include "terse/compact/pose_elimination.h"
#include "terse/core/at.h"
#include "terse/core/batch_solver.h"
#include "terse/core/error.h"
#include "terse/core/gauge.h"
#include "terse/core/pose_values.h"
#include "terse/core/residual.h"

namespace terse::internal {
namespace {

using std::size_t;

template <class Pose>
Absolute KindOfAbsolute(const PoseGraph<Pose>& graph) {
  std::set<PoseId> held, measured;
  for (const auto& node : graph.Poses()) {
    if (node.fixed) held.insert(node.id);
  }
  for (const auto& node : graph.Factors()) {
    if (const auto* pose = std::get_if<PosePriorFactor<Pose>>(&node.factor)) held.insert(pose->pose);
    if (const auto* position = std::get_if<PositionPriorFactor<Pose>>(&node.factor)) measured.insert(position->pose);
  }
  if (held.empty() && measured.empty()) return Absolute::kNone;
  if (held.size() == 1 && measured.empty()) return Absolute::kFrame;
  return FindGauge(graph, ValuesOf(graph)).IsDetermined() ? Absolute::kDatum : Absolute::kPartial;
}

}  // namespace

// The plain optimum, if no loop contradicts it; else that of truncated least squares, from the estimates of the map.
template <class Pose>
OptimalMap<Pose> ToOptimum(CompactMap<Pose> map, const std::string& name, double limit, int threads) {
  OptimalMap<Pose> part;
  part.map = std::move(map);
  PoseGraph<Pose> graph = GraphOfMap(part.map);
  const auto solve = [&](const BatchOptions& options) {
    BatchResult<Pose> result = SolveBatch(graph, ValuesOf(graph), options);
    if (result.cholesky.Variables() == 0)
      throw NumericalError("the map " + name + " has no optimum: " + result.message);
    return result;
  };
  BatchOptions options;
  options.threads = threads;
  BatchResult<Pose> result = solve(options);
  const std::vector<FactorId> loops = LoopFactors(graph);
  const auto contradicts = [&](FactorId id) {
    const auto& factor = graph.FindFactor(id)->factor;
    const FactorPoses ends = PosesOf(factor);
    const auto value = [&](PoseId pose) { return result.T_world_body[At(graph.IndexOf(pose))]; };
    return FactorChi2(factor, value(ends.first), value(ends.second)) > limit;
  };
  if (std::any_of(loops.begin(), loops.end(), contradicts)) {
    options.robust.kernel = RobustKernel::kGnc;
    options.robust.width = std::sqrt(limit);
    options.robust_factors = loops;
    options.graduate = false;
    result = solve(options);
    std::set<FactorId> out;
    auto weight = result.weights.begin();
    for (const auto& node : graph.Factors()) {
      if (*weight++ == 0) out.insert(node.id);
    }
    part.loops_out = static_cast<int>(out.size());
    auto& edges = part.map.edges;
    edges.erase(std::remove_if(edges.begin(), edges.end(), [&](const auto& e) { return out.count(e.factor) != 0; }),
                edges.end());
    for (const FactorId id : out) graph.RemoveFactor(id);
  }
  size_t k = 0;
  for (auto& pose : part.map.poses) {
    if (pose.kept) pose.T_world_body = result.T_world_body[k++];
  }
  part.graph = graph.WithPoses(result.T_world_body);
  part.absolute = KindOfAbsolute(part.graph);
  part.marginals = std::make_unique<Marginals<Pose>>(part.graph, std::move(result));
  return part;
}

template OptimalMap<SE2> ToOptimum(CompactMap<SE2>, const std::string&, double, int);
template OptimalMap<SE3> ToOptimum(CompactMap<SE3>, const std::string&, double, int);

}  // namespace terse::internal

namespace terse {

template <class Pose>
CompactMap<Pose> MapOfGraph(const PoseGraph<Pose>& graph, int threads) {
  BatchOptions options;
  options.threads = threads;
  const BatchResult<Pose> result = SolveBatch(graph, options);
  if (result.cholesky.Variables() == 0) throw NumericalError("the graph has no optimum: " + result.message);
  internal::Elimination<Pose> nothing;
  nothing.graph = graph.WithPoses(result.T_world_body);
  const std::vector<FactorId> loops = LoopFactors(graph);
  std::vector<FactorId> holding;
  for (const auto& node : graph.Factors()) {
    if (!std::binary_search(loops.begin(), loops.end(), node.id)) holding.push_back(node.id);
  }
  return internal::MapOf(nothing.graph, nothing, holding, result.T_world_body);
}

template CompactMap<SE2> MapOfGraph(const PoseGraph<SE2>&, int);
template CompactMap<SE3> MapOfGraph(const PoseGraph<SE3>&, int);

}  // namespace terse
