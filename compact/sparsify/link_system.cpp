#include "terse/compact/link_system.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "terse/compact/log_determinant.h"
#include "terse/core/at.h"
#include "terse/core/disjoint_sets.h"
#include "terse/core/gauge.h"
#include "terse/core/robust.h"

namespace terse::internal {
namespace {

template <class Pose>
const RelativePoseFactor<Pose>* RelativeOf(const Factor<Pose>& factor) {
  return std::get_if<RelativePoseFactor<Pose>>(&factor);
}

// Kruskal's algorithm over the edges, the most informative first; of equal ones the one that came first.
template <class Pose>
std::vector<FactorId> SpanningForest(const PoseGraph<Pose>& graph) {
  struct Edge {
    double weight;
    FactorId id;
    int a, b;
  };
  std::vector<Edge> edges;
  for (const auto& node : graph.Factors()) {
    const auto* edge = RelativeOf(node.factor);
    if (edge == nullptr) continue;
    const double log_det = LogDeterminant(edge->information);
    edges.push_back({log_det, node.id, graph.IndexOf(edge->from), graph.IndexOf(edge->to)});
  }
  std::stable_sort(edges.begin(), edges.end(), [](const Edge& a, const Edge& b) { return a.weight > b.weight; });
  DisjointSets parts(graph.Poses().size());
  std::vector<FactorId> forest;
  for (const Edge& edge : edges) {
    if (parts.Join(At(edge.a), At(edge.b))) forest.push_back(edge.id);
  }
  std::sort(forest.begin(), forest.end());
  return forest;
}

// Orthonormal over the poses of the part.
template <class Pose>
void SetMotions(const std::vector<int>& part, const std::vector<Pose>& T_world_body,
                std::vector<typename LinkSystem<Pose>::Motions>& motions) {
  constexpr int B = Pose::kDof, D = Pose::kDim;
  typename Pose::Position centre = Pose::Position::Zero();
  for (const int v : part) centre += T_world_body[At(v)].Translation() / static_cast<double>(part.size());
  typename Pose::Tangent to_centre = Pose::Tangent::Zero();
  to_centre.template head<D>() = -centre;
  const Pose T_centre_world = Pose().Retract(to_centre);
  Matrix<B, B> gram = Matrix<B, B>::Zero();
  for (const int v : part) {
    // Of the motion Exp(xi) about the centre: the pose moves by Ad(T_body_centre) xi.
    const typename Pose::Jacobian Ad = (T_centre_world * T_world_body[At(v)]).Inverse().Adjoint();
    motions[At(v)] = Ad.template topRows<D>();
    gram += motions[At(v)].transpose() * motions[At(v)];
  }
  // Where the part has no extent about an axis a turn moves nothing.
  gram.diagonal().array() += 1e-12 * gram.trace() + 1e-300;
  const Matrix<B, B> inverse_root = Matrix<B, B>(gram.llt().matrixL()).inverse().transpose();
  for (const int v : part) motions[At(v)] *= inverse_root;
}

// The anchor of a part, and whether absolute measurements do without alignment.
template <class Pose>
Gauge<Pose> GaugeOf(const PoseGraph<Pose>& graph, const std::vector<int>& part, const std::vector<Pose>& T_world_body,
                    const std::vector<std::vector<FactorId>>& priors_of) {
  AbsoluteInformation<Pose> absolute;
  for (const int v : part) {
    const auto& node = graph.Poses()[At(v)];
    if (node.fixed && node.T_world_body)
      absolute.Add(FixedPosePrior<Pose>(node.id, *node.T_world_body), T_world_body[At(v)]);
    for (const FactorId id : priors_of[At(v)]) absolute.Add(graph.FindFactor(id)->factor, T_world_body[At(v)]);
  }
  return absolute.FindGauge(T_world_body[At(part.front())]);
}

}  // namespace

template <class Pose>
std::vector<PoseGraph<Pose>> SplitIntoParts(const PoseGraph<Pose>& graph) {
  const auto components = ConnectedComponents(graph);
  if (components.size() < 2) return {graph};
  std::vector<int> part_of(graph.Poses().size());
  std::vector<PoseGraph<Pose>> parts(components.size());
  for (std::size_t k = 0; k < components.size(); ++k) {
    for (const int v : components[k]) part_of[At(v)] = static_cast<int>(k);
  }
  for (std::size_t v = 0; v < graph.Poses().size(); ++v) {
    const auto& node = graph.Poses()[v];
    PoseGraph<Pose>& part = parts[At(part_of[v])];
    part.AddPose(node.id, node.T_world_body);
    if (node.fixed) part.SetFixed(node.id, true);
  }
  for (const auto& node : graph.Factors()) {
    const int v = graph.IndexOf(PosesOf(node.factor).first);
    parts[At(part_of[At(v)])].AddFactor(node.factor, node.id);
  }
  return parts;
}

namespace {

// With kOdometry those that bring a pose in, of which LoopFactors has the others; else a spanning forest of largest
// information.
template <class Pose>
std::vector<FactorId> HoldingEdges(const PoseGraph<Pose>& graph, FixedEdges fixed) {
  if (fixed != FixedEdges::kOdometry) return SpanningForest(graph);
  std::vector<FactorId> loops;
  for (const auto& part : SplitIntoParts(graph)) {
    const auto of_part = LoopFactors(part);
    loops.insert(loops.end(), of_part.begin(), of_part.end());
  }
  std::sort(loops.begin(), loops.end());
  std::vector<FactorId> holding;
  for (const auto& node : graph.Factors()) {
    if (RelativeOf(node.factor) == nullptr) continue;
    if (!std::binary_search(loops.begin(), loops.end(), node.id)) holding.push_back(node.id);
  }
  return holding;
}

}  // namespace

template <class Pose>
LinkSystem<Pose> MakeLinkSystem(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body, FixedEdges fixed) {
  LinkSystem<Pose> system;
  system.poses = static_cast<int>(graph.Poses().size());
  system.motions.assign(graph.Poses().size(), LinkSystem<Pose>::Motions::Zero());
  system.holding = HoldingEdges(graph, fixed);
  std::vector<std::vector<FactorId>> priors_of(graph.Poses().size());
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int a = graph.IndexOf(ends.first), b = ends.count == 2 ? graph.IndexOf(ends.second) : -1;
    const Pose& T_a = T_world_body[At(a)];
    const auto linear = Linearize<Pose>(node.factor, a, b, T_a, b < 0 ? T_a : T_world_body[At(b)]);
    if (b < 0) priors_of[At(a)].push_back(node.id);
    const bool holds = b < 0 || std::binary_search(system.holding.begin(), system.holding.end(), node.id);
    if (b >= 0 && (!holds || fixed == FixedEdges::kNone)) {
      system.links.push_back(linear);
      system.ids.push_back(node.id);
      system.in_tree.push_back(holds);
    } else {
      system.fixed.push_back(linear);
    }
  }
  for (int v = 0; v < system.poses; ++v) {
    const auto& node = graph.Poses()[At(v)];
    if (!node.fixed || !node.T_world_body) continue;
    system.fixed.push_back(Linearize<Pose>(FixedPosePrior<Pose>(node.id, *node.T_world_body), v, -1,
                                           T_world_body[At(v)], T_world_body[At(v)]));
  }
  for (std::vector<int> part : ConnectedComponents(graph)) {
    std::sort(part.begin(), part.end());
    const Gauge<Pose> gauge = GaugeOf(graph, part, T_world_body, priors_of);
    LinearFactor<Pose::kDof> anchor = Anchor(gauge);
    anchor.first = part.front();
    system.roots.push_back(part.front());
    system.fixed.push_back(anchor);
    if (!gauge.IsDetermined()) SetMotions(part, T_world_body, system.motions);
  }
  return system;
}

#define TERSE_INSTANTIATE(Pose)                                                                           \
  template LinkSystem<Pose> MakeLinkSystem(const PoseGraph<Pose>&, const std::vector<Pose>&, FixedEdges); \
  template std::vector<PoseGraph<Pose>> SplitIntoParts(const PoseGraph<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
