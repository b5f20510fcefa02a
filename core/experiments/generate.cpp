#include "terse/core/generate.h"

#include <algorithm>
#include <limits>
#include <stdexcept>
#include <type_traits>

#include "experiments/generate_scene.h"
#include "terse/core/outliers.h"
#include "terse/core/slips.h"

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
std::size_t LinkFinder<Pose>::IndexHash::operator()(const Index& index) const {
  std::uint64_t hash = 0;
  for (const long value : index) {
    hash = (hash ^ static_cast<std::uint64_t>(value)) * 0x9E3779B97F4A7C15u;
    hash ^= hash >> 32;
  }
  return static_cast<std::size_t>(hash);
}

template <class Pose>
typename LinkFinder<Pose>::Index LinkFinder<Pose>::IndexOf(const Pose& pose) const {
  Index index{0, 0, 0};
  for (int d = 0; d < Pose::kDim; ++d) {
    index[static_cast<std::size_t>(d)] = static_cast<long>(std::floor(pose.Translation()[d] / rule_.radius_m));
  }
  return index;
}

template <class Pose>
void LinkFinder<Pose>::CollectNear(const Seen& pose, std::vector<Seen>& found) const {
  const long last = pose.pose - rule_.min_gap;
  const auto view = ViewDirection(pose.T_world_body);
  // |a - b| = 2 sin(angle / 2): exact for small angles, where the arc cosine is not.
  const double max_chord = 2 * std::sin(std::min(rule_.max_view_angle_rad, 3.141592653589793) / 2);
  const bool any_view = rule_.max_view_angle_rad > 3.141592653589793;
  const Index center = IndexOf(pose.T_world_body);
  const long depth = Pose::kDim == 3 ? 1 : 0;
  for (long dx = -1; dx <= 1; ++dx) {
    for (long dy = -1; dy <= 1; ++dy) {
      for (long dz = -depth; dz <= depth; ++dz) {
        const auto cell = cells_.find({center[0] + dx, center[1] + dy, center[2] + dz});
        if (cell == cells_.end()) continue;
        for (const auto* list : {&cell->second.oldest, &cell->second.newest}) {
          for (const Seen& other : *list) {
            const Pose& T = other.T_world_body;
            if (other.pose <= last && (T.Translation() - pose.T_world_body.Translation()).norm() < rule_.radius_m &&
                (any_view || (ViewDirection(T) - view).norm() < max_chord)) {
              found.push_back(other);
            }
          }
        }
      }
    }
  }
}

template <class Pose>
void LinkFinder<Pose>::Remember(const Seen& pose) {
  Cell& cell = cells_[IndexOf(pose.T_world_body)];
  if (cell.oldest.size() < kMostOldest) {
    cell.oldest.push_back(pose);
  } else if (cell.newest.size() < kMostNewest) {
    cell.newest.push_back(pose);
  } else {
    cell.newest[cell.next] = pose;
    cell.next = (cell.next + 1) % kMostNewest;
  }
}

template <class Pose>
std::vector<typename LinkFinder<Pose>::Seen> LinkFinder<Pose>::Next(long k, const Pose& T_world_body) {
  std::vector<Seen> found;
  for (const long offset : rule_.offsets) {
    if (offset > 1 && k - offset >= 0) found.push_back({k - offset, all_[static_cast<std::size_t>(k - offset)]});
  }
  if (!rule_.offsets.empty()) all_.push_back(T_world_body);
  if (rule_.radius_m > 0) {
    CollectNear({k, T_world_body}, found);
    Remember({k, T_world_body});
  }
  std::sort(found.begin(), found.end(), [](const Seen& a, const Seen& b) { return a.pose < b.pose; });
  const auto is_same = [](const Seen& a, const Seen& b) { return a.pose == b.pose; };
  found.erase(std::unique(found.begin(), found.end(), is_same), found.end());
  if (rule_.max_links > 0 && static_cast<long>(found.size()) > rule_.max_links) {
    found.erase(found.begin() + rule_.oldest_links, found.end() - (rule_.max_links - rule_.oldest_links));
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
RelativePoseFactor<Pose> Measure(const ScenePlan<Pose>& plan, const typename LinkFinder<Pose>::Seen& from,
                                 const typename LinkFinder<Pose>::Seen& to, Random& random) {
  const Pose T_from_to = from.T_world_body.Inverse() * to.T_world_body;
  typename Pose::Tangent sigma = plan.sigma(T_from_to), noise;
  for (int d = 0; d < Pose::kDof; ++d) {
    sigma[d] = Rounded(sigma[d]);
    noise[d] = sigma[d] * random.Normal();
  }
  RelativePoseFactor<Pose> edge;
  edge.from = {from.pose};
  edge.to = {to.pose};
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
  typename internal::LinkFinder<Pose>::Seen previous, current;
  std::vector<RelativePoseFactor<Pose>> edges;
  for (long k = 0; k < plan.poses; ++k) {
    current = {k, internal::Rounded(plan.T_world_body(k))};
    edges.clear();
    if (k > 0) edges.push_back(internal::Measure(plan, previous, current, random));
    for (const auto& other : finder.Next(k, current.T_world_body)) {
      edges.push_back(internal::Measure(plan, other, current, random));
    }
    arrive({k}, current.T_world_body, edges);
    previous = current;
  }
}

}  // namespace

template <class Pose>
void Generate(const GenerateOptions& options, const GenerateSink<Pose>& sink) {
  if (IsPlanar(options.scene) != (Pose::kDim == 2)) {
    throw std::invalid_argument(IsPlanar(options.scene) ? "this scene is planar" : "this scene is three-dimensional");
  }
  if (options.poses < 0 || options.poses == 1) throw std::invalid_argument("a scene needs at least two poses");
  if (options.area_m && options.scene != Scene::kManhattan) {
    throw std::invalid_argument("only the scene manhattan has an area");
  }
  using Edges = std::vector<RelativePoseFactor<Pose>>;
  LoopSurvey<Pose> survey(options.seed);
  if (options.wrong_loop_percent != 0) {
    GenerateTrue<Pose>(options, [&](PoseId id, const Pose&, const Edges& edges) { survey.Arrive(id, edges); });
  }
  WrongLoops<Pose> wrong_loops(survey, options.wrong_loop_percent, options.seed, options.wrong_loop_kind);
  internal::Random random(options.seed);
  const long poses = options.slips != 0 ? internal::Plan<Pose>(options, random).poses : 0;
  const Slips<Pose> slips(poses, options.slips, options.seed);
  GenerateTrue<Pose>(options, [&](PoseId id, const Pose& T_world_body, const Edges& edges) {
    if (sink.pose) sink.pose(id, T_world_body);
    for (RelativePoseFactor<Pose> edge : edges) {
      const bool is_odometry = edge.to == id && edge.from.value == id.value - 1;
      if (is_odometry && slips.Apply(id.value, edge) && sink.slip) sink.slip(edge);
      if (sink.edge) sink.edge(edge);
    }
    if (options.wrong_loop_percent == 0) return;  // nor are the poses held
    for (const auto& edge : wrong_loops.Arrive(id, T_world_body, edges)) {
      if (sink.wrong_loop) sink.wrong_loop(edge);
    }
  });
  wrong_loops.ExpectDone();
}

template void Generate<SE2>(const GenerateOptions&, const GenerateSink<SE2>&);
template void Generate<SE3>(const GenerateOptions&, const GenerateSink<SE3>&);

}  // namespace terse
