#include "terse/core/arrival.h"

#include <functional>
#include <limits>
#include <queue>
#include <stdexcept>
#include <string>
#include <tuple>

#include "graph/adjacency.h"

namespace terse {
namespace {

using internal::Adjacency;

// For vectors indexed by int.
template <class Vector>
auto& At(Vector& vector, int i) {
  return vector[static_cast<std::size_t>(i)];
}

struct PoseOrder {
  std::vector<std::vector<int>> steps;  // the poses that arrive together
  std::vector<int> position;            // of each pose in the order, -1: never arrives
};

PoseOrder OrderPoses(const Adjacency& adjacency, const std::vector<int>& by_id, const std::vector<int>& rank) {
  PoseOrder order;
  order.position.assign(by_id.size(), -1);
  std::vector<char> queued(by_id.size(), 0);
  std::priority_queue<int, std::vector<int>, std::greater<int>> ready;  // ranks
  int arrived = 0;
  for (const int newest : by_id) {
    const auto neighbours = adjacency.At(newest);
    const bool connected = std::any_of(neighbours.begin(), neighbours.end(),
                                       [&](const auto& e) { return At(order.position, e.other) >= 0; });
    if (arrived > 0 && !connected) continue;
    order.steps.emplace_back();
    ready.push(At(rank, newest));
    At(queued, newest) = 1;
    while (!ready.empty()) {
      const int pose = At(by_id, ready.top());
      ready.pop();
      At(order.position, pose) = arrived++;
      order.steps.back().push_back(pose);
      for (const auto& e : adjacency.At(pose)) {
        if (At(queued, e.other) || At(rank, e.other) > At(rank, newest)) continue;
        ready.push(At(rank, e.other));
        At(queued, e.other) = 1;
      }
    }
  }
  return order;
}

// The factors that arrive with a pose: the connecting one, then the others in the order of the graph.
struct OwnFactors {
  std::vector<int> relative, all;  // `all` has the priors too
  std::vector<int> priors;
};

OwnFactors FactorsArrivingWith(int pose, const Adjacency& adjacency, const std::vector<int>& position,
                               const std::vector<int>& rank) {
  constexpr int kNone = std::numeric_limits<int>::max();
  std::tuple<bool, int> closest{true, kNone};
  int connecting = -1;
  for (const auto& e : adjacency.At(pose)) {
    if (At(position, e.other) >= At(position, pose)) continue;
    const int gap = At(rank, pose) - At(rank, e.other);
    const std::tuple<bool, int> key{gap < 0, std::abs(gap)};
    if (key < closest) {
      closest = key;
      connecting = e.factor;
    }
  }
  OwnFactors own;
  if (connecting >= 0) {
    own.relative.push_back(connecting);
    own.all.push_back(connecting);
  }
  for (const auto& e : adjacency.At(pose)) {
    if (e.factor == connecting || At(position, e.other) > At(position, pose)) continue;
    (e.other == pose ? own.priors : own.relative).push_back(e.factor);
    own.all.push_back(e.factor);
  }
  return own;
}

}  // namespace

template <class Pose>
std::vector<ArrivalStep> ArrivalSteps(const PoseGraph<Pose>& graph, ArrivalUnit unit) {
  const Adjacency adjacency = internal::BuildAdjacency(graph);
  const std::vector<int> by_id = internal::PosesById(graph);
  std::vector<int> rank(by_id.size());
  for (std::size_t r = 0; r < by_id.size(); ++r) At(rank, by_id[r]) = static_cast<int>(r);
  const PoseOrder order = OrderPoses(adjacency, by_id, rank);
  for (const int pose : by_id) {
    if (At(order.position, pose) >= 0) continue;
    throw std::invalid_argument("the graph is not connected: no chain of edges joins pose " +
                                std::to_string(At(graph.Poses(), pose).id.value) + " to pose " +
                                std::to_string(At(graph.Poses(), by_id[0]).id.value));
  }

  std::vector<ArrivalStep> steps;
  std::vector<int> brought;  // kEdge: poses that no factor has brought in yet
  for (const std::vector<int>& poses : order.steps) {
    if (unit == ArrivalUnit::kPose) steps.push_back({poses, {}});
    for (const int pose : poses) {
      const OwnFactors own = FactorsArrivingWith(pose, adjacency, order.position, rank);
      if (unit == ArrivalUnit::kPose) {
        auto& factors = steps.back().factors;
        factors.insert(factors.end(), own.all.begin(), own.all.end());
        continue;
      }
      brought.push_back(pose);
      for (const auto* part : {&own.relative, &own.priors}) {
        for (const int factor : *part) {
          steps.push_back({std::move(brought), {factor}});
          brought.clear();
        }
      }
    }
  }
  if (!brought.empty()) steps.push_back({std::move(brought), {}});  // a single pose without factors
  return steps;
}

template std::vector<ArrivalStep> ArrivalSteps<SE2>(const PoseGraph<SE2>&, ArrivalUnit);
template std::vector<ArrivalStep> ArrivalSteps<SE3>(const PoseGraph<SE3>&, ArrivalUnit);

}  // namespace terse
