#include "terse/core/supported_loops.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <unordered_map>
#include <utility>
#include <variant>
#include <vector>

#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/loop_groups.h"
#include "terse/core/odometry_chain.h"
#include "terse/core/robust.h"

namespace terse::internal {
namespace {

using std::size_t;

constexpr int kReach = 10;         // poses
constexpr int kMostCompared = 32;  // neighbours of a loop
constexpr double kQuantile = 0.999;
// Of what is suspect: the share of the loops, how many others there are to compare with, squared errors over theirs.
constexpr double kManyAlone = 0.1, kMostAlone = 1.0 / 3, kMuchWorse = 2.5;
constexpr size_t kLeastOthers = 8;
constexpr size_t kPosesPerLoop = 4;

// Those that are edges between two poses, in order of their ids. Rank: a pose's place in order of arrival.
template <class Pose>
struct Loops {
  std::vector<FactorId> ids;
  std::vector<ForwardEdge<Pose>> edges;
};

double Median(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

template <class Pose>
class Support {
 public:
  Support(const Loops<Pose>& loops, const OdometryChain<Pose>& odometry)
      : loops_(loops.edges),
        odometry_(odometry),
        limit_(ChiSquareQuantile(kQuantile, Pose::kDof)),
        is_supported_(loops_.size()) {
    for (size_t k = 0; k < loops_.size(); ++k) {
      cells_[CellOf(loops_[k].first, loops_[k].last)].push_back(k);
    }
  }

  // Its own cell first.
  bool Find(size_t k) {
    if (is_supported_[k]) return true;
    int left = kMostCompared;
    for (const int i : {0, -1, 1}) {
      for (const int j : {0, -1, 1}) {
        const int first = loops_[k].first + i * kReach, last = loops_[k].last + j * kReach;
        if (first < 0 || last < 0) continue;
        const auto cell = cells_.find(CellOf(first, last));
        if (cell != cells_.end() && FindIn(cell->second, k, left)) return true;
      }
    }
    return false;
  }

 private:
  static std::int64_t CellOf(int first, int last) {
    return (static_cast<std::int64_t>(first / kReach) << 32) + last / kReach;
  }

  bool FindIn(const std::vector<size_t>& cell, size_t k, int& left) {
    for (const size_t other : cell) {
      if (!AreComparable(loops_[k], loops_[other])) continue;
      if (left-- == 0) return false;
      const auto cycle = CycleOf(loops_[k], loops_[other], odometry_);
      if (!cycle || cycle->Squared() > limit_) continue;
      is_supported_[k] = is_supported_[other] = 1;
      return true;
    }
    return false;
  }

  // Measured twice between the same poses is no evidence of two.
  static bool AreComparable(const ForwardEdge<Pose>& a, const ForwardEdge<Pose>& b) {
    const int heads = std::abs(a.first - b.first), tails = std::abs(a.last - b.last);
    return heads <= kReach && tails <= kReach && heads + tails > 0;
  }

  const std::vector<ForwardEdge<Pose>>& loops_;
  const OdometryChain<Pose>& odometry_;
  double limit_;
  std::vector<char> is_supported_;
  std::unordered_map<std::int64_t, std::vector<size_t>> cells_;  // of loops_ by the ranks of their ends
};

}  // namespace

template <class Pose>
std::vector<FactorId> UnsupportedLoops(const PoseGraph<Pose>& graph) {
  return FindSupport(graph).unsupported;
}

template <class Pose>
LoopSupport FindSupport(const PoseGraph<Pose>& graph) {
  const std::vector<int> rank = PlacesInArrival(graph);
  const std::vector<FactorId> candidates = LoopFactors(graph);
  Loops<Pose> loops;
  std::vector<ForwardEdge<Pose>> steps;
  for (const auto& node : graph.Factors()) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
    if (edge == nullptr) continue;
    const int from = rank[At(graph.IndexOf(edge->from))], to = rank[At(graph.IndexOf(edge->to))];
    const bool is_loop = std::binary_search(candidates.begin(), candidates.end(), node.id);
    if (!is_loop && std::abs(from - to) != 1) continue;
    ForwardEdge<Pose> forward = Forward(0, from, to, *edge);
    if (std::abs(from - to) == 1) steps.push_back(forward);
    if (!is_loop) continue;
    loops.ids.push_back(node.id);
    loops.edges.push_back(std::move(forward));
  }
  const OdometryChain<Pose> odometry(steps, rank.size());
  Support<Pose> support(loops, odometry);
  LoopSupport out;
  out.loops = candidates.size();
  std::vector<double> alone, others;  // squared errors
  for (size_t k = 0; k < loops.ids.size(); ++k) {
    const bool is_supported = support.Find(k);
    if (!is_supported) out.unsupported.push_back(loops.ids[k]);
    const auto cycle = CycleOf(loops.edges[k], odometry);
    if (cycle) (is_supported ? others : alone).push_back(cycle->Squared());
  }
  std::sort(out.unsupported.begin(), out.unsupported.end());
  const double share =
      static_cast<double>(out.unsupported.size()) / static_cast<double>(std::max<size_t>(1, out.loops));
  if (!alone.empty() && !others.empty()) out.alone_over_others = Median(alone) / Median(others);
  out.are_suspect = share > kManyAlone && others.size() >= kLeastOthers && !alone.empty() &&
                    (share > kMostAlone || out.alone_over_others > kMuchWorse);
  out.others_are_many = (out.loops - out.unsupported.size()) * kPosesPerLoop >= rank.size();
  return out;
}

template std::vector<FactorId> UnsupportedLoops<SE2>(const PoseGraph<SE2>&);
template std::vector<FactorId> UnsupportedLoops<SE3>(const PoseGraph<SE3>&);
template LoopSupport FindSupport<SE2>(const PoseGraph<SE2>&);
template LoopSupport FindSupport<SE3>(const PoseGraph<SE3>&);

}  // namespace terse::internal
