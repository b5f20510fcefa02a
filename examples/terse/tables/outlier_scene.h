#pragma once
// Graphs with wrong loops, and what a map made of them: its error and which loops it believes.

#include <algorithm>
#include <cstdint>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "run/ground_truth.h"
#include "terse/core/outliers.h"

namespace terse {

using PosePair = std::pair<std::int64_t, std::int64_t>;
inline PosePair PairOf(PoseId a, PoseId b) { return std::minmax(a.value, b.value); }

// A graph with wrong loops or none. No true edge joins the pair of a wrong one.
template <class Pose>
struct Contaminated {
  double percent = 0;
  PoseGraph<Pose> graph;
  std::set<PosePair> wrong;
  std::uint64_t seed = 0;
};

// A clean graph and the poses that its maps are compared with, which wrong loops are drawn against too.
template <class Pose>
struct OutlierScene {
  std::string name;
  double width = 0;  // of the robust kernels; 0: the default
  PoseGraph<Pose> graph;
  Reference<Pose> reference;

  // `percent` of the number of true loops, as AddWrongLoops has it.
  Contaminated<Pose> With(double percent, std::uint64_t seed, OutlierKind kind = OutlierKind::kRandom) const {
    Contaminated<Pose> out{percent, graph, {}, seed};
    if (percent == 0) return out;
    auto added = AddWrongLoops(graph, reference.T_world_body, percent, seed, kind);
    for (const FactorId id : added.wrong) {
      const auto& loop = std::get<RelativePoseFactor<Pose>>(added.graph.FindFactor(id)->factor);
      out.wrong.insert(PairOf(loop.from, loop.to));
    }
    out.graph = std::move(added.graph);
    return out;
  }
};

// Loops that are there and those that the map believes, which is a weight of at least one half.
struct LoopCounts {
  int true_loops = 0, wrong_loops = 0;
  int true_kept = 0, wrong_kept = 0;
};

// `weight(k, id)`: of the k-th factor of the graph, whose id is `id`. Asked for loops only (LoopFactors).
template <class Pose, class WeightOf>
LoopCounts CountLoops(const PoseGraph<Pose>& graph, const std::set<PosePair>& wrong, const WeightOf& weight) {
  LoopCounts out;
  const std::vector<FactorId> loops = LoopFactors(graph);
  std::size_t k = 0;
  for (const auto& node : graph.Factors()) {
    if (std::binary_search(loops.begin(), loops.end(), node.id)) {
      const FactorPoses ends = PosesOf(node.factor);
      const bool is_wrong = wrong.count(PairOf(ends.first, ends.second)) != 0;
      const bool is_kept = weight(k, node.id) >= 0.5;
      ++(is_wrong ? out.wrong_loops : out.true_loops);
      if (is_kept) ++(is_wrong ? out.wrong_kept : out.true_kept);
    }
    ++k;
  }
  return out;
}

// As the recovered trajectory of a map that keeps all poses.
template <class Pose>
std::vector<RecoveredPose<Pose>> AsTrajectory(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body) {
  std::vector<RecoveredPose<Pose>> out;
  for (std::size_t k = 0; k < T_world_body.size(); ++k) out.push_back({graph.Poses()[k].id, true, T_world_body[k]});
  return out;
}

}  // namespace terse
