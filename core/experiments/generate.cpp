#include "terse/core/generate.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <type_traits>

#include "experiments/generate_scene.h"
#include "terse/core/outliers.h"

namespace terse {
namespace internal {

SE2 Rounded(const SE2& T) {
  return SE2(Rounded(T.Translation().x()), Rounded(T.Translation().y()), Rounded(T.Theta()));
}

SE3 Rounded(const SE3& T) {
  const Quaternion& q = T.Rotation().Unit();
  const Vector<3>& p = T.Translation();
  return SE3(SO3(Quaternion(Rounded(q.w()), Rounded(q.x()), Rounded(q.y()), Rounded(q.z()))),
             Vector<3>(Rounded(p.x()), Rounded(p.y()), Rounded(p.z())));
}

Vector<2> ViewDirection(const SE2& T_world_body) { return T_world_body.Rotation().col(0); }
Vector<3> ViewDirection(const SE3& T_world_body) { return T_world_body.Rotation() * Vector<3>(0, 0, 1); }

template <class Pose>
std::size_t LinkFinder<Pose>::CellHash::operator()(const Cell& cell) const {
  std::uint64_t hash = 0;
  for (const long index : cell) {
    hash = (hash ^ static_cast<std::uint64_t>(index)) * 0x9E3779B97F4A7C15u;
    hash ^= hash >> 32;
  }
  return static_cast<std::size_t>(hash);
}

template <class Pose>
typename LinkFinder<Pose>::Cell LinkFinder<Pose>::CellOf(const Pose& pose) const {
  Cell cell{0, 0, 0};
  for (int d = 0; d < Pose::kDim; ++d) {
    cell[static_cast<std::size_t>(d)] = static_cast<long>(std::floor(pose.Translation()[d] / rule_.radius_m));
  }
  return cell;
}

template <class Pose>
void LinkFinder<Pose>::CollectNear(const std::vector<Pose>& poses, std::vector<long>& found) const {
  const Pose& pose = poses.back();
  const long last = static_cast<long>(poses.size()) - 1 - rule_.min_gap;
  const auto view = ViewDirection(pose);
  // |a - b| = 2 sin(angle / 2): exact for small angles, where the arc cosine is not.
  const double max_chord = 2 * std::sin(std::min(rule_.max_view_angle_rad, 3.141592653589793) / 2);
  const bool any_view = rule_.max_view_angle_rad > 3.141592653589793;
  const Cell center = CellOf(pose);
  const long depth = Pose::kDim == 3 ? 1 : 0;
  for (long dx = -1; dx <= 1; ++dx) {
    for (long dy = -1; dy <= 1; ++dy) {
      for (long dz = -depth; dz <= depth; ++dz) {
        const auto cell = newest_.find({center[0] + dx, center[1] + dy, center[2] + dz});
        if (cell == newest_.end()) continue;
        for (long j = cell->second; j >= 0; j = previous_[static_cast<std::size_t>(j)]) {
          const Pose& other = poses[static_cast<std::size_t>(j)];
          if (j <= last && (other.Translation() - pose.Translation()).norm() < rule_.radius_m &&
              (any_view || (ViewDirection(other) - view).norm() < max_chord)) {
            found.push_back(j);
          }
        }
      }
    }
  }
}

template <class Pose>
std::vector<long> LinkFinder<Pose>::Next(const std::vector<Pose>& poses) {
  const long k = static_cast<long>(poses.size()) - 1;
  std::vector<long> found;
  for (const long offset : rule_.offsets) {
    if (offset > 1 && k - offset >= 0) found.push_back(k - offset);
  }
  if (rule_.radius_m > 0) {
    CollectNear(poses, found);
    const auto [cell, is_new] = newest_.emplace(CellOf(poses.back()), k);
    previous_.push_back(is_new ? -1 : cell->second);
    cell->second = k;
  }
  std::sort(found.begin(), found.end());
  found.erase(std::unique(found.begin(), found.end()), found.end());
  if (rule_.max_links > 0 && static_cast<long>(found.size()) > rule_.max_links) {
    found.erase(found.begin(), found.end() - rule_.max_links);
  }
  return found;
}

template class LinkFinder<SE2>;
template class LinkFinder<SE3>;

namespace {

template <class Pose>
ScenePlan<Pose> Plan(const GenerateOptions& options, Random& random) {
  if constexpr (std::is_same_v<Pose, SE2>) {
    return PlanManhattan(options, random);
  } else {
    switch (options.scene) {
      case Scene::kEllipse: return PlanEllipse(options);
      case Scene::kEllipseN: return PlanEllipseLaps(options);
      case Scene::kSphere: return PlanSphere(options);
      case Scene::kTorus: return PlanTorus(options);
      default: return PlanGarage(options);
    }
  }
}

template <class Pose>
RelativePoseFactor<Pose> Measure(const ScenePlan<Pose>& plan, const std::vector<Pose>& poses, long from, long to,
                                 Random& random) {
  const Pose T_from_to = poses[static_cast<std::size_t>(from)].Inverse() * poses[static_cast<std::size_t>(to)];
  typename Pose::Tangent sigma = plan.sigma(T_from_to), noise;
  for (int d = 0; d < Pose::kDof; ++d) {
    sigma[d] = Rounded(sigma[d]);
    noise[d] = sigma[d] * random.Normal();
  }
  RelativePoseFactor<Pose> edge;
  edge.from = {from};
  edge.to = {to};
  // The residual at the truth, Local(Z^-1 T_from_to), is then the noise itself.
  edge.T_from_to = Rounded(T_from_to * Pose().Retract(noise).Inverse());
  edge.information.setZero();
  for (int d = 0; d < Pose::kDof; ++d) edge.information(d, d) = Rounded(1 / (sigma[d] * sigma[d]));
  return edge;
}

}  // namespace
}  // namespace internal

std::optional<Scene> SceneFromName(const std::string& name) {
  if (name == "ellipse") return Scene::kEllipse;
  if (name == "ellipse-n") return Scene::kEllipseN;
  if (name == "sphere") return Scene::kSphere;
  if (name == "torus") return Scene::kTorus;
  if (name == "manhattan") return Scene::kManhattan;
  if (name == "garage") return Scene::kGarage;
  return std::nullopt;
}

bool IsPlanar(Scene scene) { return scene == Scene::kManhattan; }

namespace {

// The next pose with all its edges.
template <class Pose>
using Arrive = std::function<void(PoseId id, const Pose& T_world_body, const std::vector<RelativePoseFactor<Pose>>&)>;

template <class Pose>
void GenerateTrue(const GenerateOptions& options, const Arrive<Pose>& arrive) {
  internal::Random random(options.seed);
  const internal::ScenePlan<Pose> plan = internal::Plan<Pose>(options, random);
  internal::LinkFinder<Pose> finder(plan.links);
  std::vector<Pose> poses;
  poses.reserve(static_cast<std::size_t>(plan.poses));
  std::vector<RelativePoseFactor<Pose>> edges;
  for (long k = 0; k < plan.poses; ++k) {
    poses.push_back(internal::Rounded(plan.T_world_body(k)));
    const std::vector<long> links = finder.Next(poses);
    edges.clear();
    if (k > 0) edges.push_back(internal::Measure(plan, poses, k - 1, k, random));
    for (const long j : links) edges.push_back(internal::Measure(plan, poses, j, k, random));
    arrive({k}, poses.back(), edges);
  }
}

}  // namespace

template <class Pose>
void Generate(const GenerateOptions& options, const GenerateSink<Pose>& sink) {
  if (IsPlanar(options.scene) != (Pose::kDim == 2)) {
    throw std::invalid_argument(IsPlanar(options.scene) ? "this scene is planar" : "this scene is three-dimensional");
  }
  if (options.poses < 0 || options.poses == 1) throw std::invalid_argument("a scene needs at least two poses");
  using Edges = std::vector<RelativePoseFactor<Pose>>;
  LoopSurvey<Pose> survey(options.seed);
  if (options.wrong_loop_percent != 0) {
    GenerateTrue<Pose>(options, [&](PoseId id, const Pose&, const Edges& edges) { survey.Arrive(id, edges); });
  }
  WrongLoops<Pose> wrong_loops(survey, options.wrong_loop_percent, options.seed);
  GenerateTrue<Pose>(options, [&](PoseId id, const Pose& T_world_body, const Edges& edges) {
    if (sink.pose) sink.pose(id, T_world_body);
    for (const auto& edge : edges) {
      if (sink.edge) sink.edge(edge);
    }
    for (const auto& edge : wrong_loops.Arrive(id, T_world_body, edges)) {
      if (sink.wrong_loop) sink.wrong_loop(edge);
    }
  });
  wrong_loops.ExpectDone();
}

template void Generate<SE2>(const GenerateOptions&, const GenerateSink<SE2>&);
template void Generate<SE3>(const GenerateOptions&, const GenerateSink<SE3>&);

}  // namespace terse
