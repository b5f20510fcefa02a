#include "terse/core/loop_groups.h"

#include <algorithm>
#include <cstdlib>
#include <map>

#include "terse/core/arrival.h"
#include "terse/core/at.h"
#include "terse/core/disjoint_sets.h"

namespace terse::internal {
namespace {

using Ends = std::pair<int, int>;
constexpr int kReach = 10;  // places
constexpr std::size_t kMostCompared = 32;

}  // namespace

template <class Pose>
std::vector<int> PlacesInArrival(const PoseGraph<Pose>& graph) {
  std::vector<int> places(graph.Poses().size());
  int next = 0;
  for (const ArrivalStep& step : ArrivalSteps(graph, ArrivalUnit::kPose)) {
    for (const int pose : step.poses) places[At(pose)] = next++;
  }
  return places;
}

std::vector<std::vector<std::size_t>> GroupLoops(const std::vector<Ends>& places) {
  std::map<Ends, std::vector<std::size_t>> cells;  // as wide as the reach
  DisjointSets sets(places.size());
  const auto join_near = [&](std::size_t k, const std::vector<std::size_t>& cell) {
    const Ends& a = places[k];
    for (std::size_t i = cell.size() - std::min(cell.size(), kMostCompared); i < cell.size(); ++i) {
      const Ends& b = places[cell[i]];
      if (std::abs(a.first - b.first) <= kReach && std::abs(a.second - b.second) <= kReach) sets.Join(k, cell[i]);
    }
  };
  for (std::size_t k = 0; k < places.size(); ++k) {
    const Ends at(places[k].first / kReach, places[k].second / kReach);
    for (const int i : {-1, 0, 1}) {
      for (const int j : {-1, 0, 1}) {
        const auto it = cells.find({at.first + i, at.second + j});
        if (it != cells.end()) join_near(k, it->second);
      }
    }
    cells[at].push_back(k);
  }
  std::map<std::size_t, std::vector<std::size_t>> by_root;
  for (std::size_t k = 0; k < places.size(); ++k) by_root[sets.Root(k)].push_back(k);
  std::vector<std::vector<std::size_t>> groups;
  groups.reserve(by_root.size());
  for (auto& entry : by_root) groups.push_back(std::move(entry.second));
  return groups;
}

template std::vector<int> PlacesInArrival<SE2>(const PoseGraph<SE2>&);
template std::vector<int> PlacesInArrival<SE3>(const PoseGraph<SE3>&);

}  // namespace terse::internal
