#include "terse/compact/supported_loops.h"

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <optional>
#include <unordered_map>
#include <utility>

#include "terse/compact/innovation.h"
#include "terse/compact/uncertain_pose.h"
#include "terse/core/arrival.h"
#include "terse/core/at.h"
#include "terse/core/chi_square.h"
#include "terse/core/robust.h"

namespace terse::internal {
namespace {

using std::size_t;

constexpr int kReach = 10;         // poses
constexpr int kMostCompared = 32;  // neighbours of a loop
constexpr double kQuantile = 0.999;

template <class Pose>
class Support {
 public:
  explicit Support(const PoseGraph<Pose>& graph) : graph_(graph), limit_(ChiSquareQuantile(kQuantile, Pose::kDof)) {
    FindChain();
    for (const FactorId id : LoopFactors(graph)) AddLoop(id);
  }

  // As LoopFactors has them, ascending.
  std::vector<FactorId> Unsupported() {
    std::vector<FactorId> out;
    for (size_t k = 0; k < loops_.size(); ++k) {
      if (!loops_[k].is_supported && !FindSupport(static_cast<int>(k))) out.push_back(loops_[k].id);
    }
    return out;
  }

 private:
  struct Loop {
    FactorId id;
    int first, second;  // ranks of its ends, ascending
    UncertainPose<Pose> measured;
    bool is_supported = false;
  };

  // Ranks by arrival, and the odometry that joins each pose to the one before.
  void FindChain() {
    rank_.resize(graph_.Poses().size());
    int next = 0;
    for (const ArrivalStep& step : ArrivalSteps(graph_, ArrivalUnit::kPose)) {
      for (const int pose : step.poses) rank_[At(pose)] = next++;
    }
    odometry_.resize(rank_.size());
    for (const auto& node : graph_.Factors()) {
      const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&node.factor);
      if (edge == nullptr) continue;
      const int from = RankOf(edge->from), to = RankOf(edge->to);
      auto& place = odometry_[At(std::max(from, to))];
      if (std::abs(from - to) == 1 && !place) place = SeenFrom(from < to ? edge->from : edge->to, *edge);
    }
  }
  int RankOf(PoseId id) const { return rank_[At(graph_.IndexOf(id))]; }

  void AddLoop(FactorId id) {
    const auto* edge = std::get_if<RelativePoseFactor<Pose>>(&graph_.FindFactor(id)->factor);
    if (edge == nullptr) return;
    const int from = RankOf(edge->from), to = RankOf(edge->to);
    const PoseId first = from < to ? edge->from : edge->to;
    cells_[CellOf(std::min(from, to), std::max(from, to))].push_back(static_cast<int>(loops_.size()));
    loops_.push_back({id, std::min(from, to), std::max(from, to), SeenFrom(first, *edge)});
  }
  static std::int64_t CellOf(int first, int second) {
    return (static_cast<std::int64_t>(first / kReach) << 32) + second / kReach;
  }

  // Its own cell first.
  bool FindSupport(int k) {
    int left = kMostCompared;
    for (const int i : {0, -1, 1}) {
      for (const int j : {0, -1, 1}) {
        const int first = loops_[At(k)].first + i * kReach, second = loops_[At(k)].second + j * kReach;
        if (first < 0 || second < 0) continue;
        const auto cell = cells_.find(CellOf(first, second));
        if (cell != cells_.end() && FindSupportIn(cell->second, loops_[At(k)], left)) return true;
      }
    }
    return false;
  }

  bool FindSupportIn(const std::vector<int>& cell, Loop& loop, int& left) {
    for (const int k : cell) {
      Loop& other = loops_[At(k)];
      if (!AreComparable(loop, other)) continue;
      if (left-- == 0) return false;
      if (!Agree(loop, other)) continue;
      loop.is_supported = other.is_supported = true;
      return true;
    }
    return false;
  }

  // Measured twice between the same poses is no evidence of two.
  static bool AreComparable(const Loop& a, const Loop& b) {
    const int heads = std::abs(a.first - b.first), tails = std::abs(a.second - b.second);
    return heads <= kReach && tails <= kReach && heads + tails > 0;
  }

  bool Agree(const Loop& a, const Loop& b) const {
    const auto head = Between(b.first, a.first), tail = Between(a.second, b.second);
    if (!head || !tail) return false;
    return InnovationDistance(Compose(Compose(*head, a.measured), *tail), b.measured) <= limit_;
  }

  // Along the odometry; nothing if it breaks off.
  std::optional<UncertainPose<Pose>> Between(int from, int to) const {
    UncertainPose<Pose> path;
    for (int rank = std::min(from, to) + 1; rank <= std::max(from, to); ++rank) {
      const auto& step = odometry_[At(rank)];
      if (!step) return std::nullopt;
      path = Compose(path, *step);
    }
    return from <= to ? path : Invert(path);
  }

  const PoseGraph<Pose>& graph_;
  double limit_;
  std::vector<int> rank_;                                     // by pose index
  std::vector<std::optional<UncertainPose<Pose>>> odometry_;  // by rank, from the one before
  std::vector<Loop> loops_;
  std::unordered_map<std::int64_t, std::vector<int>> cells_;  // of loops_ by the ranks of their ends
};

}  // namespace

template <class Pose>
std::vector<FactorId> UnsupportedLoops(const PoseGraph<Pose>& graph) {
  return Support<Pose>(graph).Unsupported();
}

template std::vector<FactorId> UnsupportedLoops<SE2>(const PoseGraph<SE2>&);
template std::vector<FactorId> UnsupportedLoops<SE3>(const PoseGraph<SE3>&);

}  // namespace terse::internal
