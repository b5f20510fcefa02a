#pragma once
// Errors of an estimated trajectory against a reference: ATE and RPE (Sturm et al., IROS 2012), KITTI's t_rel, r_rel.

#include <optional>
#include <vector>

#include "terse/core/trajectory.h"

namespace terse {

// How the estimate is laid over the reference before ATE. kSE3: least squares over the positions (Umeyama without
// scale). kSE2: the same about the z axis and in x, y only. kNone: as they are.
enum class Alignment { kSE3, kSE2, kNone };

struct PoseError {
  double translation_m = 0;  // root mean square
  double rotation_deg = 0;   // root mean square of the angle
};

struct KittiError {
  double t_rel_percent = 0;
  double r_rel_deg_per_100m = 0;
  long segments = 0;
};

struct Evaluation {
  PoseError ate;      // after alignment, pose by pose
  PoseError rpe;      // from each matched pose to the next
  PoseError rpe_all;  // every ordered pair i < j, exactly
  int poses = 0;      // matched
  std::optional<KittiError> kitti;
};

struct EvaluateOptions {
  Alignment alignment = Alignment::kSE3;
  bool all_pairs = true;  // rpe_all, in O(n^2); otherwise it stays 0
  bool kitti = false;     // the devkit's metric: 100..800 m, a start every 10 frames
  int threads = 0;        // for rpe_all; 0: all cores. The result does not depend on it.
};

// Two trajectories on the same stamps, index by index. Throws std::invalid_argument if sizes differ or are < 2.
Evaluation Evaluate(const std::vector<SE3>& T_world_estimate, const std::vector<SE3>& T_world_reference,
                    const EvaluateOptions& options = {});

// Of these only the ATE in metres, with the same conditions: a small part of the work.
double AbsoluteError(const std::vector<SE3>& T_world_estimate, const std::vector<SE3>& T_world_reference,
                     Alignment alignment = Alignment::kSE3);

// T_reference_estimate: the motion that lays the estimated positions over the reference, as for ATE. Of the same number
// of poses each, at least one; they are not checked.
SE3 Align(const std::vector<SE3>& T_world_estimate, const std::vector<SE3>& T_world_reference, Alignment alignment);

// The poses of both at matching stamps, as {estimate, reference}. KITTI files have line numbers for stamps, so
// they match graph ids; against a TUM file in seconds with as many poses they match line by line; two TUM files
// match at the nearest stamp within 10 ms. Throws std::invalid_argument with a reason if fewer than two match.
struct MatchedTrajectories {
  std::vector<SE3> T_world_estimate, T_world_reference;
};
MatchedTrajectories Match(const Trajectory& estimate, const Trajectory& reference);

}  // namespace terse
