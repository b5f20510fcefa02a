#pragma once
// What the poses of a graph are compared with: true poses where they are known, else the optimum of the graph.

#include <optional>
#include <string>
#include <vector>

#include "terse/compact/run_steps.h"
#include "terse/core/batch_solver.h"
#include "terse/core/evaluate.h"
#include "terse/core/pose_graph.h"

namespace terse {

// kExact: of the generator. kFile: a trajectory file. kGrid, kSphere: derived as below. kOptimum: least chi2 of the
// full graph, so errors against it leave out what its own measurements are off.
enum class ReferenceKind { kExact, kFile, kGrid, kSphere, kOptimum };
const char* Name(ReferenceKind kind);

template <class Pose>
struct Reference {
  ReferenceKind kind = ReferenceKind::kOptimum;
  std::vector<Pose> T_world_body;  // by pose index of the graph
};

// Of a simulated walk over a grid of whole metres with quarter turns: the odometry, rounded to them, composed from the
// identity on. Absent if an edge disagrees with that by 0.9 m or an eighth of a turn, or the odometry does not reach
// every pose.
std::optional<std::vector<SE2>> GridTruth(const PoseGraph<SE2>& graph);

// Of the public sphere2500: pose k on ring l = k / 50 at longitude 2 pi k / 50 and colatitude pi (l + 1) / 51 of a
// sphere of 50 m; body x east, y north, z up. (Its optimum is 0.78 m and a degree from there.) Absent if the ids are
// not 0..2499, or an edge disagrees by 5 m or a half radian.
std::optional<std::vector<SE3>> SphereTruth(const PoseGraph<SE3>& graph);

// Of the ids, as ReadTruth says; of a 2D map within its plane.
template <class Pose>
TruePoses ReadTruePoses(std::vector<PoseId> ids, const std::string& path);

// A trajectory file, by pose ids (lines of a KITTI file) or, with as many poses, line by line. Throws FileError, or
// std::invalid_argument if a pose of the graph is not there.
template <class Pose>
std::vector<Pose> ReadTruth(const PoseGraph<Pose>& graph, const std::string& path);

// What is known of a graph file's true poses: a trajectory STEM.tum beside it; else, in 2D, GridTruth; for sphere2500
// SphereTruth; for kitti00_all_loops kitti/poses/00.txt in `folder` or beside it, one or two folders up. Else kOptimum,
// without poses yet. Throws what ReadTruth throws.
template <class Pose>
Reference<Pose> FindReference(const PoseGraph<Pose>& graph, const std::string& path, const std::string& folder);

// The better of two starts (the values in the file if all are there, chordal), as the file's values lead to a local
// minimum on some graphs. Throws NumericalError if neither converges.
template <class Pose>
BatchResult<Pose> BatchOptimum(const PoseGraph<Pose>& graph);

// Root mean squares against a reference.
struct TrajectoryErrors {
  PoseError ate, rpe, rpe_all;  // after alignment in the graph's dimension; pose to next; all pairs
  int stride = 1;               // ate and rpe_all are of every so manieth pose
};
// All pairs are O(n^2): above `most_poses`, ate and rpe_all take every k-th pose.
// Throws std::invalid_argument if a pose is not in the graph, or there are fewer than two.
template <class Pose>
TrajectoryErrors ComputeErrors(const PoseGraph<Pose>& graph, const Reference<Pose>& reference,
                               const std::vector<RecoveredPose<Pose>>& estimate, std::size_t most_poses = 20000);

// Of these only the ATE, metres, of all poses: O(n).
template <class Pose>
double ComputeAte(const PoseGraph<Pose>& graph, const Reference<Pose>& reference,
                  const std::vector<RecoveredPose<Pose>>& estimate);

// The expected error of an optimum that serves as reference, root mean square of the positions in metres after
// alignment, to first order: sqrt(V / n), V = tr(P Sigma_pp P) with the gauge's motions taken out by P
// (compact/aligned_variance.h) and n poses. As good as the information is a covariance. Throws NumericalError if the
// result has no factor.
template <class Pose>
double ExpectedErrorOf(const PoseGraph<Pose>& graph, BatchResult<Pose> optimum);

}  // namespace terse
