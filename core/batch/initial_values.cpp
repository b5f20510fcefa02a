#include "terse/core/initial_values.h"

#include <stdexcept>
#include <string>

#include "batch/chordal.h"
#include "graph/adjacency.h"
#include "terse/core/arrival.h"
#include "terse/core/pose_name.h"
#include "terse/core/position_start.h"
#include "terse/core/start_values.h"
#include "terse/core/words.h"

namespace terse {
namespace {

template <class Pose>
std::vector<Pose> FileValues(const PoseGraph<Pose>& graph) {
  std::vector<Pose> values;
  values.reserve(graph.Poses().size());
  for (const auto& node : graph.Poses()) {
    if (!node.T_world_body) throw std::invalid_argument(Name(node.id) + " has no value");
    values.push_back(*node.T_world_body);
  }
  return values;
}

// The first pose's file value or that of its first pose prior.
template <class Pose>
std::optional<Pose> KnownStart(const PoseGraph<Pose>& graph, int first) {
  const auto& node = graph.Poses()[static_cast<std::size_t>(first)];
  if (node.T_world_body) return node.T_world_body;
  for (const auto& f : graph.Factors()) {
    const auto* prior = std::get_if<PosePriorFactor<Pose>>(&f.factor);
    if (prior != nullptr && prior->pose == node.id) return prior->T_world_body;
  }
  return std::nullopt;
}

// Gives the pose at one end of a relative factor its value from the other end, if just one has a value.
template <class Pose>
class Composer {
 public:
  Composer(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first)
      : graph_(graph), values_(graph.Poses().size()), known_(graph.Poses().size(), 0) {
    Set(static_cast<std::size_t>(first), T_world_first);
  }

  void Follow(int factor) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&graph_.Factors()[static_cast<std::size_t>(factor)].factor);
    if (f == nullptr) return;
    const auto from = static_cast<std::size_t>(graph_.IndexOf(f->from));
    const auto to = static_cast<std::size_t>(graph_.IndexOf(f->to));
    if (known_[from] == known_[to]) return;
    if (known_[from]) {
      Set(to, values_[from] * f->T_from_to);
    } else {
      Set(from, values_[to] * f->T_from_to.Inverse());
    }
  }

  std::vector<Pose> Take() { return std::move(values_); }

 private:
  // Long chains drift off the group by rounding.
  void Set(std::size_t pose, Pose T_world_body) {
    T_world_body.Normalize();
    values_[pose] = T_world_body;
    known_[pose] = 1;
  }

  const PoseGraph<Pose>& graph_;
  std::vector<Pose> values_;
  std::vector<char> known_;
};

template <class Pose>
std::vector<Pose> ComposeAlongArrival(const PoseGraph<Pose>& graph, int first, const Pose& T_world_first) {
  Composer<Pose> composer(graph, first, T_world_first);
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int factor : step.factors) composer.Follow(factor);
  }
  return composer.Take();
}

struct Tree {
  std::vector<int> factors;  // in breadth-first order
  std::size_t poses = 0;
};

template <class Pose>
Tree BreadthFirst(const PoseGraph<Pose>& graph, int first) {
  const internal::Adjacency adjacency = internal::BuildAdjacency(graph);
  std::vector<char> seen(graph.Poses().size(), 0);
  std::vector<int> queue{first};
  seen[static_cast<std::size_t>(first)] = 1;
  Tree tree;
  for (std::size_t next = 0; next < queue.size(); ++next) {
    for (const auto& e : adjacency.At(queue[next])) {
      if (seen[static_cast<std::size_t>(e.other)]) continue;
      seen[static_cast<std::size_t>(e.other)] = 1;
      queue.push_back(e.other);
      tree.factors.push_back(e.factor);
    }
  }
  tree.poses = queue.size();
  return tree;
}

template <class Pose>
void MoveTo(const Pose& T_new_old, std::vector<Pose>& values) {
  for (Pose& value : values) value = T_new_old * value;
}

}  // namespace

const char* Name(InitialValues method) { return WordOf(method); }

template <class Pose>
std::vector<Pose> ComputeInitialValues(const PoseGraph<Pose>& graph, InitialValues method,
                                       const StartOptions& options) {
  if (method == InitialValues::kFile) return FileValues(graph);
  if (method == InitialValues::kAuto && !graph.Poses().empty()) return ChooseStart(graph, options).T_world_body;
  if (graph.Poses().empty()) return {};
  const std::vector<int> by_id = internal::PosesById(graph);
  const Tree tree = BreadthFirst(graph, by_id[0]);
  if (tree.poses != graph.Poses().size()) throw std::invalid_argument("the graph is not connected");

  const std::optional<Pose> start = KnownStart(graph, by_id[0]);
  const Pose T_world_first = start.value_or(Pose());
  std::vector<Pose> values;
  if (method == InitialValues::kChordal) {
    values = internal::ChordalValues(graph, by_id[0], T_world_first, options);
  } else {
    if (method == InitialValues::kCompose) {
      values = ComposeAlongArrival(graph, by_id[0], T_world_first);
    } else {
      Composer<Pose> composer(graph, by_id[0], T_world_first);
      for (const int factor : tree.factors) composer.Follow(factor);
      values = composer.Take();
    }
    // Then each stretch, and each fixed pose, is where it belongs.
    if (internal::MoveToPositionPriors(graph, by_id, values) == internal::PositionStart::kPiecewise) return values;
  }

  for (const int pose : by_id) {
    const auto& node = graph.Poses()[static_cast<std::size_t>(pose)];
    if (!node.fixed || !node.T_world_body) continue;
    Pose& value = values[static_cast<std::size_t>(pose)];
    MoveTo(*node.T_world_body * value.Inverse(), values);
    value = *node.T_world_body;  // exactly
    break;
  }
  for (Pose& value : values) value.Normalize();
  return values;
}

template std::vector<SE2> ComputeInitialValues<SE2>(const PoseGraph<SE2>&, InitialValues, const StartOptions&);
template std::vector<SE3> ComputeInitialValues<SE3>(const PoseGraph<SE3>&, InitialValues, const StartOptions&);

}  // namespace terse
