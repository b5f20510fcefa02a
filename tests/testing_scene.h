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

}  // namespace terse::testing
