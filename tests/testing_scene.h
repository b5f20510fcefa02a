#pragma once
// Generated scenes as graphs.

#include "terse/core/generate.h"
#include "testing.h"

namespace terse::testing {

// The pose values are the true ones.
template <class Pose>
RandomGraph<Pose> MakeScene(Scene scene, long poses, std::uint64_t seed = 1) {
  RandomGraph<Pose> out;
  GenerateOptions options;
  options.scene = scene;
  options.poses = poses;
  options.seed = seed;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose& T) {
    out.truth.push_back(T);
    out.graph.AddPose(id, T);
  };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { out.graph.AddFactor(edge); };
  Generate(options, sink);
  return out;
}

// The first poses of a graph, with what joins them.
template <class Pose>
PoseGraph<Pose> FirstPoses(const PoseGraph<Pose>& graph, std::size_t count) {
  PoseGraph<Pose> out;
  for (std::size_t k = 0; k < count; ++k) {
    const auto& pose = graph.Poses()[k];
    out.AddPose(pose.id, pose.T_world_body);
    out.SetFixed(pose.id, pose.fixed);
  }
  const auto is_in = [&](PoseId id) { return graph.IndexOf(id) < static_cast<int>(count); };
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    if (is_in(ends.first) && (ends.count == 1 || is_in(ends.second))) out.AddFactor(node.factor);
  }
  return out;
}

}  // namespace terse::testing
