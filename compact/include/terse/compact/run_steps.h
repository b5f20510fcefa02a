#pragma once
// How a compact run grows, step by step.

#include <cstdint>
#include <optional>
#include <set>
#include <string>
#include <unordered_map>
#include <utility>
#include <vector>

#include "terse/compact/compact_pose_slam.h"

namespace terse {

// What there is after a step.
struct CompactStep {
  PoseId pose;               // that came in
  int poses = 0, links = 0;  // kept so far
  double seconds = 0;        // of the step
  // Nats: the greatest measured gain among the links that were added; absent without one, and of apal and rfpfl.
  std::optional<double> gain;
  std::optional<bool> gate_open;  // of the map's updates; absent if the pose was dropped
  std::optional<double> gate_value;
  // At some steps only: scalars of the lower triangle of H and of its factor L, and the error against the true poses.
  std::optional<std::int64_t> hessian_nonzeros, factor_nonzeros;
  std::optional<double> ate_m;
};

// True poses by id; those of a 2D map within its plane.
using TruePoses = std::unordered_map<std::int64_t, SE3>;

// Gathers them while a run goes on. Costs little: what takes time is taken at some 300 steps (the error at 100), evenly
// spread, and at the last one.
template <class Pose>
class StepRecorder {
 public:
  // `steps`: that the run will have. `truth`: of every pose, also of those that the map has seen before; or nullptr.
  explicit StepRecorder(int steps, const TruePoses* truth = nullptr);
  void Add(const CompactPoseSlam<Pose>& slam, const Decision& decision, double seconds);
  // Of the poses that the map remembers.
  const std::vector<CompactStep>& Steps() const { return steps_; }

 private:
  std::int64_t HessianNonzeros(const PoseGraph<Pose>& graph);
  std::optional<double> Ate(const CompactPoseSlam<Pose>& slam);
  void DropForgotten(const CompactPoseSlam<Pose>& slam);

  int expected_, stride_;
  int added_ = 0;
  long forgotten_ = 0;  // poses, when the steps were last looked through
  const TruePoses* truth_;
  std::vector<SE3> true_;  // in order of arrival, as far as it was asked for
  std::size_t counted_ = 0;
  std::set<std::pair<std::int64_t, std::int64_t>> pairs_;  // blocks of H: of the factors counted
  std::vector<CompactStep> steps_;
};

// A row per step. `earlier`: rows, without the header, of the run that this one continues.
void WriteCompactSteps(const std::vector<CompactStep>& steps, const std::string& earlier, const std::string& path);

}  // namespace terse
