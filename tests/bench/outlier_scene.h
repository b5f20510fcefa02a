#pragma once
// Graphs with wrong loops.

#include <algorithm>
#include <set>
#include <string>

#include "run/ground_truth.h"
#include "terse/core/outliers.h"

namespace terse::bench {

constexpr double kQuantile = 0.9999;  // of the innovation test, as CompactOptions has it

using Pair = std::pair<std::int64_t, std::int64_t>;
inline Pair PairOf(PoseId a, PoseId b) { return std::minmax(a.value, b.value); }

// A graph with wrong loops or none. No true edge joins the pair of a wrong one.
template <class Pose>
struct Contaminated {
  double percent = 0;
  PoseGraph<Pose> graph;
  std::set<Pair> wrong;
};

template <class Pose>
struct Scene {
  std::string name;
  double width = 0;  // of the robust kernels; 0: the default
  PoseGraph<Pose> graph;
  Reference<Pose> reference;

  Contaminated<Pose> With(double percent, std::uint64_t seed) const {
    Contaminated<Pose> out{percent, graph, {}};
    if (percent == 0) return out;
    auto added = AddWrongLoops(graph, reference.T_world_body, percent, seed);
    for (const FactorId id : added.wrong) {
      const auto& loop = std::get<RelativePoseFactor<Pose>>(added.graph.FindFactor(id)->factor);
      out.wrong.insert(PairOf(loop.from, loop.to));
    }
    out.graph = std::move(added.graph);
    return out;
  }
};

// All information times a factor: the same optimum, another covariance.
template <class Pose>
PoseGraph<Pose> Scaled(const PoseGraph<Pose>& graph, double factor) {
  PoseGraph<Pose> out;
  for (const auto& pose : graph.Poses()) {
    out.AddPose(pose.id, pose.T_world_body);
    out.SetFixed(pose.id, pose.fixed);
  }
  for (const auto& node : graph.Factors()) {
    Factor<Pose> scaled = node.factor;
    std::visit([&](auto& f) { f.information *= factor; }, scaled);
    out.AddFactor(scaled);
  }
  return out;
}

}  // namespace terse::bench
