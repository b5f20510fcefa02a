#pragma once
// Graphs for tests of the compact run, and the run over them.

#include <memory>
#include <vector>

#include "terse/compact/compact_pose_slam.h"
#include "terse/compact/graph_replay.h"
#include "testing_scene.h"

namespace terse::testing {

// The same edges with exact measurements.
template <class Pose>
PoseGraph<Pose> WithoutNoise(const RandomGraph<Pose>& scene) {
  PoseGraph<Pose> out;
  for (std::size_t k = 0; k < scene.truth.size(); ++k) out.AddPose(scene.graph.Poses()[k].id, scene.truth[k]);
  const auto true_pose = [&](PoseId id) { return scene.truth[static_cast<std::size_t>(scene.graph.IndexOf(id))]; };
  for (const auto& node : scene.graph.Factors()) {
    auto edge = std::get<RelativePoseFactor<Pose>>(node.factor);
    edge.T_from_to = true_pose(edge.from).Inverse() * true_pose(edge.to);
    out.AddFactor(edge);
  }
  return out;
}

template <class Pose>
CompactOptions<Pose> OptionsFor(const GraphReplay<Pose>& replay, Strategy strategy) {
  CompactOptions<Pose> options;
  options.strategy = strategy;
  options.range = replay.LinkRange();
  options.link_covariance = replay.LinkCovariance();
  return options;
}

template <class Pose>
struct CompactRun {
  std::unique_ptr<CompactPoseSlam<Pose>> slam;
  std::vector<Decision> decisions;
};

template <class Pose>
CompactRun<Pose> RunCompact(GraphReplay<Pose>& replay, const CompactOptions<Pose>& options) {
  CompactRun<Pose> run{std::make_unique<CompactPoseSlam<Pose>>(options), {}};
  const auto registration = replay.AsRegistration();
  for (const auto& input : replay.Inputs()) run.decisions.push_back(run.slam->AddPose(input, registration));
  return run;
}

template <class Pose>
CompactRun<Pose> RunCompact(const PoseGraph<Pose>& graph, Strategy strategy, double min_loop_gain,
                            double min_pose_gain) {
  GraphReplay<Pose> replay(graph);
  auto options = OptionsFor(replay, strategy);
  options.min_loop_gain = min_loop_gain;
  options.min_pose_gain = min_pose_gain;
  return RunCompact(replay, options);
}

template <class Pose>
double Distance(const Pose& a, const Pose& b) {
  return (a.Inverse() * b).Log().norm();
}

}  // namespace terse::testing
