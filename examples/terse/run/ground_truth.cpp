#include "run/ground_truth.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <stdexcept>

#include "terse/compact/graph_replay.h"
#include "terse/compact/rigid_motions.h"
#include "terse/core/error.h"
#include "terse/core/stamped_trajectory.h"
#include "terse/covariance/marginals.h"

namespace terse {
namespace {

using std::size_t;

constexpr double kPi = 3.14159265358979323846;

void TakeFrom(const SE3& T, SE3& out) { out = T; }
void TakeFrom(const SE3& T, SE2& out) {
  const Vector<3> x = T.Rotation() * Vector<3>(1, 0, 0);
  out = SE2(T.Translation().x(), T.Translation().y(), std::atan2(x.y(), x.x()));
}

// Does every relative measurement agree with the poses within these bounds (metres, radians)?
template <class Pose>
bool Agrees(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body, double metres, double radians) {
  for (const auto& node : graph.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const Pose T_from_to = T_world_body[static_cast<size_t>(graph.IndexOf(edge->from))].Inverse() *
                           T_world_body[static_cast<size_t>(graph.IndexOf(edge->to))];
    const Pose error = edge->T_from_to.Inverse() * T_from_to;
    if (!(error.Translation().norm() < metres && error.Angle() < radians)) return false;
  }
  return true;
}

std::vector<SE3> Strided(const std::vector<SE3>& poses, int stride) {
  std::vector<SE3> out;
  for (size_t k = 0; k < poses.size(); k += static_cast<size_t>(stride)) out.push_back(poses[k]);
  return out;
}

// In space, in the order of ids.
template <class Pose>
std::pair<std::vector<SE3>, std::vector<SE3>> EstimateAndReference(const PoseGraph<Pose>& graph,
                                                                   const Reference<Pose>& reference,
                                                                   const std::vector<RecoveredPose<Pose>>& estimate) {
  std::vector<size_t> order(estimate.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::sort(order.begin(), order.end(), [&](size_t a, size_t b) { return estimate[a].id < estimate[b].id; });
  std::pair<std::vector<SE3>, std::vector<SE3>> out;
  for (const size_t k : order) {
    out.first.push_back(InSpace(estimate[k].T_world_body));
    out.second.push_back(InSpace(reference.T_world_body[static_cast<size_t>(graph.IndexOf(estimate[k].id))]));
  }
  return out;
}

// From each pose to the next, as Evaluate has it.
PoseError ErrorToNext(const std::vector<SE3>& estimate, const std::vector<SE3>& reference) {
  double translation = 0, rotation = 0;
  const double count = static_cast<double>(estimate.size() - 1);
  for (size_t k = 1; k < estimate.size(); ++k) {
    const SE3 error = (reference[k - 1].Inverse() * reference[k]).Inverse() * (estimate[k - 1].Inverse() * estimate[k]);
    translation += error.Translation().squaredNorm();
    rotation += error.Angle() * error.Angle();
  }
  return {std::sqrt(translation / count), 180 / kPi * std::sqrt(rotation / count)};
}

}  // namespace

const char* Name(ReferenceKind kind) {
  switch (kind) {
    case ReferenceKind::kExact: return "exact";
    case ReferenceKind::kFile: return "file";
    case ReferenceKind::kGrid: return "grid";
    case ReferenceKind::kSphere: return "sphere";
    case ReferenceKind::kOptimum: return "optimum";
  }
  return "";
}

std::optional<std::vector<SE2>> GridTruth(const PoseGraph<SE2>& graph) {
  std::vector<SE2> T_world_body(graph.Poses().size());
  const GraphReplay<SE2> replay(graph);
  const auto at = [&](PoseId id) -> SE2& { return T_world_body[static_cast<size_t>(graph.IndexOf(id))]; };
  for (const auto& input : replay.Inputs()) {
    if (!input.odometry) continue;
    const SE2& Z = input.odometry->T_from_to;
    const SE2 step(std::round(Z.Translation().x()), std::round(Z.Translation().y()),
                   kPi / 2 * std::round(Z.Theta() / (kPi / 2)));
    const bool is_forward = input.odometry->to == input.id;
    at(input.id) = is_forward ? at(input.odometry->from) * step : at(input.odometry->to) * step.Inverse();
  }
  if (!Agrees(graph, T_world_body, 0.9, kPi / 4)) return std::nullopt;
  return T_world_body;
}

std::optional<std::vector<SE3>> SphereTruth(const PoseGraph<SE3>& graph) {
  constexpr int kPoses = 2500, kPerRing = 50, kRings = 51;
  constexpr double kRadius = 50;
  if (graph.Poses().size() != kPoses) return std::nullopt;
  std::vector<SE3> T_world_body(kPoses);
  for (std::int64_t k = 0; k < kPoses; ++k) {
    if (!graph.HasPose({k})) return std::nullopt;
    const double longitude = 2 * kPi * static_cast<double>(k) / kPerRing;
    const double colatitude = kPi * static_cast<double>(k / kPerRing + 1) / kRings;
    const Vector<3> east(-std::sin(longitude), std::cos(longitude), 0);
    const Vector<3> up(std::sin(colatitude) * std::cos(longitude), std::sin(colatitude) * std::sin(longitude),
                       std::cos(colatitude));
    Matrix<3, 3> R;
    R << east, up.cross(east), up;
    T_world_body[static_cast<size_t>(graph.IndexOf({k}))] = SE3(SO3::FromMatrix(R), kRadius * up);
  }
  if (!Agrees(graph, T_world_body, 5, 0.5)) return std::nullopt;
  return T_world_body;
}

template <class Pose>
TruePoses ReadTruePoses(std::vector<PoseId> ids, const std::string& path) {
  const Trajectory trajectory = ReadTrajectory(path);
  std::sort(ids.begin(), ids.end());
  const bool by_line = trajectory.format == TrajectoryFormat::kTum && trajectory.stamps.size() == ids.size();
  TruePoses out;
  for (size_t k = 0; k < ids.size(); ++k) {
    const double stamp = static_cast<double>(ids[k].value);
    const auto found = std::lower_bound(trajectory.stamps.begin(), trajectory.stamps.end(), stamp);
    size_t at = static_cast<size_t>(found - trajectory.stamps.begin());
    if (by_line) at = k;
    if (!by_line && (found == trajectory.stamps.end() || *found != stamp)) {
      throw std::invalid_argument(path + ": no pose " + std::to_string(ids[k].value));
    }
    Pose T_world_body;
    TakeFrom(trajectory.T_world_body[at], T_world_body);
    out[ids[k].value] = InSpace(T_world_body);
  }
  return out;
}

template <class Pose>
std::vector<Pose> ReadTruth(const PoseGraph<Pose>& graph, const std::string& path) {
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  const TruePoses truth = ReadTruePoses<Pose>(ids, path);
  std::vector<Pose> out(ids.size());
  for (size_t k = 0; k < ids.size(); ++k) TakeFrom(truth.at(ids[k].value), out[k]);
  return out;
}

template <class Pose>
Reference<Pose> FindReference(const PoseGraph<Pose>& graph, const std::string& path, const std::string& folder) {
  namespace fs = std::filesystem;
  const std::string stem = fs::path(path).stem().string();
  const fs::path beside = fs::path(path).replace_extension(".tum");
  if (fs::exists(beside)) return {ReferenceKind::kFile, ReadTruth(graph, beside.string())};
  if constexpr (Pose::kDim == 2) {
    if (auto truth = GridTruth(graph)) return {ReferenceKind::kGrid, std::move(*truth)};
  } else {
    if (stem == "sphere2500") {
      if (auto truth = SphereTruth(graph)) return {ReferenceKind::kSphere, std::move(*truth)};
    }
    if (stem == "kitti00_all_loops") {
      for (const char* place : {"../../kitti/poses/00.txt", "../kitti/poses/00.txt", "kitti/poses/00.txt"}) {
        const fs::path truth = fs::path(folder) / place;
        if (fs::exists(truth)) return {ReferenceKind::kFile, ReadTruth(graph, truth.string())};
      }
    }
  }
  return {};
}

template <class Pose>
BatchResult<Pose> BatchOptimum(const PoseGraph<Pose>& graph) {
  BatchResult<Pose> best = SolveBatch(graph);
  if (!best.Converged()) throw NumericalError("no batch optimum to compare with: " + best.message);
  return best;
}

template <class Pose>
TrajectoryErrors ComputeErrors(const PoseGraph<Pose>& graph, const Reference<Pose>& reference,
                               const std::vector<RecoveredPose<Pose>>& estimate, std::size_t most_poses) {
  const auto [T_estimate, T_reference] = EstimateAndReference(graph, reference, estimate);
  TrajectoryErrors errors;
  errors.stride = static_cast<int>((estimate.size() + most_poses - 1) / std::max<size_t>(1, most_poses));
  EvaluateOptions how;
  how.alignment = Pose::kDim == 2 ? Alignment::kSE2 : Alignment::kSE3;
  const Evaluation result =
      errors.stride <= 1 ? Evaluate(T_estimate, T_reference, how)
                         : Evaluate(Strided(T_estimate, errors.stride), Strided(T_reference, errors.stride), how);
  errors.ate = result.ate;
  errors.rpe_all = result.rpe_all;
  errors.rpe = errors.stride <= 1 ? result.rpe : ErrorToNext(T_estimate, T_reference);
  return errors;
}

template <class Pose>
double ComputeAte(const PoseGraph<Pose>& graph, const Reference<Pose>& reference,
                  const std::vector<RecoveredPose<Pose>>& estimate) {
  const auto [T_estimate, T_reference] = EstimateAndReference(graph, reference, estimate);
  return AbsoluteError(T_estimate, T_reference, Pose::kDim == 2 ? Alignment::kSE2 : Alignment::kSE3);
}

template <class Pose>
double ExpectedErrorOf(const PoseGraph<Pose>& graph, BatchResult<Pose> optimum) {
  const internal::RigidMotions<Pose> motions(optimum.T_world_body);
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  const Marginals<Pose> marginals(graph, std::move(optimum));
  double variance = -marginals.Combination(motions.Terms(ids)).trace();
  for (const auto& Sigma : marginals.AllMarginals()) {
    variance += Sigma.template topLeftCorner<Pose::kDim, Pose::kDim>().trace();  // body frame: a trace does not care
  }
  return std::sqrt(std::max(0.0, variance) / static_cast<double>(ids.size()));
}

#define TERSE_INSTANTIATE(Pose)                                                                                 \
  template TruePoses ReadTruePoses<Pose>(std::vector<PoseId>, const std::string&);                              \
  template std::vector<Pose> ReadTruth<Pose>(const PoseGraph<Pose>&, const std::string&);                       \
  template Reference<Pose> FindReference<Pose>(const PoseGraph<Pose>&, const std::string&, const std::string&); \
  template double ComputeAte<Pose>(const PoseGraph<Pose>&, const Reference<Pose>&,                              \
                                   const std::vector<RecoveredPose<Pose>>&);                                    \
  template double ExpectedErrorOf<Pose>(const PoseGraph<Pose>&, BatchResult<Pose>);                             \
  template BatchResult<Pose> BatchOptimum<Pose>(const PoseGraph<Pose>&);                                        \
  template TrajectoryErrors ComputeErrors<Pose>(const PoseGraph<Pose>&, const Reference<Pose>&,                 \
                                                const std::vector<RecoveredPose<Pose>>&, std::size_t);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
