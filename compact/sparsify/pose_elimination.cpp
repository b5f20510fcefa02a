#include "terse/compact/pose_elimination.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>
#include <string>
#include <tuple>

#include "factor_recovery.h"
#include "terse/core/at.h"
#include "terse/core/pose_name.h"
#include "terse/lie/se2.h"
#include "terse/lie/se3.h"

namespace terse::internal {
namespace {

template <class Pose>
class Eliminator {
 public:
  Eliminator(const PoseGraph<Pose>& graph, const EliminationOptions& options);
  Elimination<Pose> Run();

 private:
  // A relative factor under way.
  struct Edge {
    RelativePoseFactor<Pose> measured;
    std::optional<FactorId> id;  // in the graph that came
    int made_by = -1;            // the pose whose elimination made it
    std::vector<int> made_of;    // the edges on the ways that it stands for
    int from = 0, to = 0;        // pose indices
    bool is_alive = true;
  };
  struct Plan {
    std::vector<int> neighbours;
    std::vector<int> spent;  // the edges it replaces
    Tree<Pose> recovered;
  };

  bool GoesOn() const { return !options_.progress || options_.progress(static_cast<int>(out_.eliminated.size())); }
  PoseId IdOf(int pose) const { return graph_.Poses()[At(pose)].id; }
  const Pose& Estimate(int pose) const { return *graph_.Poses()[At(pose)].T_world_body; }
  std::vector<int> EdgesBetween(int a, int b) const;
  std::vector<int> NeighboursOf(int pose) const;
  std::vector<int> CliqueOf(int pose, const std::vector<int>& neighbours) const;
  Clique<Pose> Sum(int pose, const Plan& plan) const;

  void AddEdge(Edge edge);
  void RemoveEdge(int edge);
  void LookAt(int pose);
  void Eliminate(int pose);
  std::vector<int> WaysOf(int pose, int a, int b) const;
  std::vector<PoseId> ThroughOf(int edge) const;
  void MakeGraph();

  const PoseGraph<Pose>& graph_;
  const EliminationOptions& options_;
  Elimination<Pose> out_;
  std::vector<Edge> edges_;
  std::vector<std::map<int, std::vector<int>>> links_;  // by pose: of every neighbour the edges to it
  std::vector<char> stays_, is_gone_;
  std::vector<std::optional<Plan>> plans_;
  std::set<std::tuple<double, int, int>> order_;  // loss, neighbours, pose
};

template <class Pose>
Eliminator<Pose>::Eliminator(const PoseGraph<Pose>& graph, const EliminationOptions& options)
    : graph_(graph), options_(options) {
  const std::size_t poses = graph.Poses().size();
  links_.resize(poses);
  plans_.resize(poses);
  stays_.assign(poses, 0);
  is_gone_.assign(poses, 0);
  for (std::size_t k = 0; k < poses; ++k) {
    const auto& node = graph.Poses()[k];
    if (!node.T_world_body) throw std::invalid_argument(Name(node.id) + " has no value");
    stays_[k] = node.fixed;
  }
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    const int first = graph.IndexOf(ends.first);
    if (ends.count == 2) {
      AddEdge({std::get<RelativePoseFactor<Pose>>(node.factor), node.id, -1, {}, first, graph.IndexOf(ends.second)});
    } else {
      stays_[At(first)] = 1;
    }
  }
  for (const auto& part : ConnectedComponents(graph)) stays_[At(part.front())] = stays_[At(part.back())] = 1;
  for (const PoseId id : options.stay) stays_[At(graph.IndexOf(id))] = 1;
}

template <class Pose>
void Eliminator<Pose>::AddEdge(Edge edge) {
  const int number = static_cast<int>(edges_.size());
  links_[At(edge.from)][edge.to].push_back(number);
  links_[At(edge.to)][edge.from].push_back(number);
  edges_.push_back(std::move(edge));
}

template <class Pose>
void Eliminator<Pose>::RemoveEdge(int number) {
  Edge& edge = edges_[At(number)];
  edge.is_alive = false;
  links_[At(edge.from)].erase(edge.to);
  links_[At(edge.to)].erase(edge.from);
}

template <class Pose>
std::vector<int> Eliminator<Pose>::EdgesBetween(int a, int b) const {
  const auto found = links_[At(a)].find(b);
  return found != links_[At(a)].end() ? found->second : std::vector<int>();
}

template <class Pose>
std::vector<int> Eliminator<Pose>::NeighboursOf(int pose) const {
  std::vector<int> neighbours;
  for (const auto& [neighbour, edges] : links_[At(pose)]) neighbours.push_back(neighbour);
  return neighbours;
}

template <class Pose>
std::vector<int> Eliminator<Pose>::CliqueOf(int pose, const std::vector<int>& neighbours) const {
  std::vector<int> clique;
  const auto add = [&](int a, int b) {
    const std::vector<int> edges = EdgesBetween(a, b);
    clique.insert(clique.end(), edges.begin(), edges.end());
  };
  for (std::size_t i = 0; i < neighbours.size(); ++i) {
    add(pose, neighbours[i]);
    for (std::size_t j = i + 1; j < neighbours.size(); ++j) add(neighbours[i], neighbours[j]);
  }
  return clique;
}

template <class Pose>
Clique<Pose> Eliminator<Pose>::Sum(int pose, const Plan& plan) const {
  Clique<Pose> sum;
  const auto add_all = [&](int a, int b, Arm<Pose>& arm) {
    for (const int number : EdgesBetween(a, b)) arm.Add(IdOf(a), edges_[At(number)].measured);
  };
  const int size = static_cast<int>(plan.neighbours.size());
  for (int i = 0; i < size; ++i) {
    const int a = plan.neighbours[At(i)];
    sum.arms.emplace_back(Estimate(pose).Inverse() * Estimate(a));
    add_all(pose, a, sum.arms.back());
    for (int j = i + 1; j < size; ++j) {
      const int b = plan.neighbours[At(j)];
      if (links_[At(a)].count(b) == 0) continue;
      const auto made = sum.between.emplace(std::pair(i, j), Arm<Pose>(Estimate(a).Inverse() * Estimate(b)));
      add_all(a, b, made.first->second);
    }
  }
  return sum;
}

template <class Pose>
void Eliminator<Pose>::LookAt(int pose) {
  std::optional<Plan>& plan = plans_[At(pose)];
  if (plan) order_.erase({plan->recovered.loss, static_cast<int>(plan->neighbours.size()), pose});
  plan.reset();
  const int neighbours = static_cast<int>(links_[At(pose)].size());
  if (stays_[At(pose)] || is_gone_[At(pose)] || neighbours > options_.most_neighbours) return;
  Plan next;
  next.neighbours = NeighboursOf(pose);
  next.spent = CliqueOf(pose, next.neighbours);
  const Clique<Pose> clique = Sum(pose, next);
  auto recovered = RecoverFactors(clique, options_.recovered, options_.conservative);
  if (!recovered) return;
  next.recovered = std::move(*recovered);
  order_.emplace(next.recovered.loss, neighbours, pose);
  plan = std::move(next);
}

template <class Pose>
std::vector<int> Eliminator<Pose>::WaysOf(int pose, int a, int b) const {
  std::vector<int> ways;
  for (const auto& [from, to] : {std::pair(pose, a), std::pair(pose, b), std::pair(a, b)}) {
    const std::vector<int> edges = EdgesBetween(from, to);
    ways.insert(ways.end(), edges.begin(), edges.end());
  }
  return ways;
}

// Gathered at the end, once for each edge that is left: carried along, they would be copied at every elimination.
template <class Pose>
std::vector<PoseId> Eliminator<Pose>::ThroughOf(int edge) const {
  std::vector<int> to_look_at = {edge};
  std::set<int> seen = {edge};
  std::vector<PoseId> through;
  while (!to_look_at.empty()) {
    const Edge& made = edges_[At(to_look_at.back())];
    to_look_at.pop_back();
    if (made.made_by >= 0) through.push_back(IdOf(made.made_by));
    for (const int part : made.made_of) {
      if (seen.insert(part).second) to_look_at.push_back(part);
    }
  }
  std::sort(through.begin(), through.end());
  through.erase(std::unique(through.begin(), through.end()), through.end());
  return through;
}

template <class Pose>
void Eliminator<Pose>::Eliminate(int pose) {
  const Plan plan = *plans_[At(pose)];
  EliminatedPose<Pose> eliminated{IdOf(pose), plan.recovered.loss, {}};
  std::vector<Edge> edges;
  for (const TreeFactor<Pose>& factor : plan.recovered.factors) {
    const int a = plan.neighbours[At(factor.i)], b = plan.neighbours[At(factor.j)];
    edges.push_back(
        {{IdOf(a), IdOf(b), factor.T_i_j, factor.information}, std::nullopt, pose, WaysOf(pose, a, b), a, b});
  }
  for (const int number : plan.spent) RemoveEdge(number);
  for (Edge& edge : edges) AddEdge(std::move(edge));
  is_gone_[At(pose)] = 1;
  LookAt(pose);
  for (const int neighbour : plan.neighbours) {
    LookAt(neighbour);
    eliminated.neighbours.push_back(IdOf(neighbour));
  }
  out_.loss += eliminated.loss;
  out_.eliminated.push_back(std::move(eliminated));
}

template <class Pose>
Elimination<Pose> Eliminator<Pose>::Run() {
  const int poses = static_cast<int>(graph_.Poses().size());
  for (int pose = 0; pose < poses && !out_.stopped; ++pose) {
    out_.stopped = !GoesOn();
    if (poses > options_.least_kept) LookAt(pose);
  }
  while (!out_.stopped && !order_.empty() &&
         poses - static_cast<int>(out_.eliminated.size()) > std::max(options_.least_kept, 0)) {
    const int pose = std::get<2>(*order_.begin());
    // An elimination next to two of its neighbours has changed what is between these.
    if (CliqueOf(pose, plans_[At(pose)]->neighbours) != plans_[At(pose)]->spent) {
      LookAt(pose);
    } else if (!GoesOn()) {
      out_.stopped = true;
    } else {
      Eliminate(pose);
    }
  }
  MakeGraph();
  return std::move(out_);
}

template <class Pose>
void Eliminator<Pose>::MakeGraph() {
  for (std::size_t k = 0; k < is_gone_.size(); ++k) {
    const auto& node = graph_.Poses()[k];
    if (is_gone_[k]) continue;
    out_.graph.AddPose(node.id, node.T_world_body);
    out_.graph.SetFixed(node.id, node.fixed);
  }
  std::set<FactorId> spent;
  for (const Edge& edge : edges_) {
    if (edge.id && !edge.is_alive) spent.insert(*edge.id);
  }
  for (const auto& node : graph_.Factors()) {
    if (spent.count(node.id) == 0) out_.graph.AddFactor(node.factor, node.id);
  }
  FactorId next = graph_.NextFactorId();
  for (int number = 0; number < static_cast<int>(edges_.size()); ++number) {
    const Edge& edge = edges_[At(number)];
    if (edge.id || !edge.is_alive) continue;
    out_.graph.AddFactor(edge.measured, next);
    out_.recovered.push_back({next, ThroughOf(number)});
    ++next.value;
  }
}

}  // namespace

template <class Pose>
Elimination<Pose> EliminatePoses(const PoseGraph<Pose>& graph, const EliminationOptions& options) {
  return Eliminator<Pose>(graph, options).Run();
}

#define TERSE_INSTANTIATE(Pose) \
  template Elimination<Pose> EliminatePoses(const PoseGraph<Pose>&, const EliminationOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
