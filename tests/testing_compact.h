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
  options.thresholds.range = replay.LinkRange();
  options.thresholds.link_covariance = replay.LinkCovariance();
  return options;
}

template <class Pose>
struct ReplayedRun {
  std::unique_ptr<CompactPoseSlam<Pose>> slam;
  std::vector<Decision> decisions;
};

template <class Pose>
ReplayedRun<Pose> RunReplay(GraphReplay<Pose>& replay, const CompactOptions<Pose>& options) {
  ReplayedRun<Pose> run{std::make_unique<CompactPoseSlam<Pose>>(options), {}};
  for (const auto& input : replay.Inputs()) run.decisions.push_back(run.slam->AddPose(input));
  return run;
}

template <class Pose>
ReplayedRun<Pose> RunReplay(const PoseGraph<Pose>& graph, Strategy strategy, double min_loop_gain,
                            double min_pose_gain) {
  GraphReplay<Pose> replay(graph);
  auto options = OptionsFor(replay, strategy);
  options.thresholds.min_loop_gain = min_loop_gain;
  options.thresholds.min_pose_gain = min_pose_gain;
  return RunReplay(replay, options);
}

// Once around a circle in twenty steps, and on over the first ten poses, each of which is linked to the one twenty
// steps before. The tenth step slips by three metres, far more than its covariance says: every link is true, disagrees
// with the map and agrees with the others.
struct SlippingCircle {
  explicit SlippingCircle(int consensus = 3) {
    options.strategy = Strategy::kApfl;
    options.thresholds.range = Vector<3>(5, 5, 4);
    options.thresholds.min_loop_gain = 0.1;
    options.thresholds.link_covariance = 1e-4 * Matrix<3, 3>::Identity();
    options.consensus = consensus;
    options.failed_neighbourhood = 0;  // it is only these pairs that match
    const Matrix<3, 3> information = 1e4 * Matrix<3, 3>::Identity();
    const SE2 step(1, 0, 2 * M_PI / 20);
    std::vector<SE2> truth = {SE2()};
    inputs.resize(30);
    inputs[0].id = PoseId{0};
    for (int k = 1; k < 30; ++k) {
      truth.push_back(truth.back() * step);
      CompactInput<SE2>& input = inputs[static_cast<std::size_t>(k)];
      input.id = PoseId{k};
      input.odometry =
          RelativePoseFactor<SE2>{PoseId{k - 1}, PoseId{k}, k == 10 ? step * SE2(3, 0, 0) : step, information};
    }
    registration = [truth, information](PoseId i, PoseId n) -> std::optional<RelativePoseFactor<SE2>> {
      if (n.value - i.value != 20) return std::nullopt;
      const SE2 T = truth[static_cast<std::size_t>(i.value)].Inverse() * truth[static_cast<std::size_t>(n.value)];
      return RelativePoseFactor<SE2>{i, n, T, information};
    };
  }

  CompactOptions<SE2> options;
  std::vector<CompactInput<SE2>> inputs;
  Registration<SE2> registration;
};

template <class Pose>
double Distance(const Pose& a, const Pose& b) {
  return (a.Inverse() * b).Log().norm();
}

}  // namespace terse::testing
