// Carry::kOffset: estimate = linearisation point + d.

#include <algorithm>
#include <cmath>
#include <set>

#include "incremental_plan.h"
#include "stopwatch.h"
#include "terse/core/gauge.h"

namespace terse {
namespace {

using internal::ScopedTimer;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// Relinearised factors may cost this many times as much as before (curved valleys climb a little) before the
// points go only part of the way, at least this share of it.
constexpr double kClimb = 4, kLeastShare = 0.05;
// A d this many times its tolerance does not wait for the interval.
constexpr double kUrgent = 30;

}  // namespace

template <class Pose>
bool IncrementalSolver<Pose>::ExceedsTolerance(int variable, double times) const {
  const double* d = factor_.Solution().data() + At(variable) * B;
  double metres2 = 0, radians2 = 0;
  for (int k = 0; k < Pose::kDim; ++k) metres2 += d[k] * d[k];
  for (int k = Pose::kDim; k < B; ++k) radians2 += d[k] * d[k];
  return metres2 > std::pow(times * options_.relinearize_metres, 2) ||
         radians2 > std::pow(times * options_.relinearize_radians, 2);
}

template <class Pose>
LinearFactor<Pose::kDof> IncrementalSolver<Pose>::LinearizeSlot(int slot, const PointOf& point) const {
  const LinearFactor<B>& was = factor_.FactorAt(slot);
  if (slot == anchor_slot_) return was;  // proximal: the same at any value
  const FactorId id = factor_of_slot_[At(slot)];
  const int second = was.second < 0 ? was.first : was.second;
  if (id.value >= 0) {
    return Linearize(graph_.FindFactor(id)->factor, was.first, second, point(was.first), point(second));
  }
  const auto& fixed = graph_.Poses()[At(was.first)];
  return Linearize<Pose>(FixedPosePrior<Pose>(fixed.id, *fixed.T_world_body), was.first, was.first, point(was.first),
                         point(was.first));
}

// The factors on these poses at the poses' new points.
template <class Pose>
typename IncrementalSolver<Pose>::Replacements IncrementalSolver<Pose>::LinearizeAround(
    const std::map<int, Pose>& points) const {
  std::set<int> slots;
  for (const auto& [v, T] : points) slots.insert(factor_.SlotsOf(v).begin(), factor_.SlotsOf(v).end());
  const auto point = [&](int v) -> const Pose& {
    const auto it = points.find(v);
    return it != points.end() ? it->second : linearization_points_[At(v)];
  };
  Replacements out;
  out.reserve(slots.size());
  for (const int slot : slots) out.emplace_back(slot, LinearizeSlot(slot, point));
  return out;
}

// Moves linearisation points; their d becomes zero. If the factor does not take it, nothing changes.
template <class Pose>
bool IncrementalSolver<Pose>::Relinearize(const std::map<int, Pose>& points, Replacements replaced,
                                          StepReport& report) {
  typename BlockCholesky<B>::Changes changes;
  std::vector<LinearFactor<B>> before;
  for (const auto& change : replaced) before.push_back(factor_.FactorAt(change.first));
  changes.replaced = std::move(replaced);
  std::vector<int> slots;
  for (const auto& change : changes.replaced) slots.push_back(change.first);
  if (!UpdateFactor(std::move(changes), report).ok) return false;
  for (const auto& factor : before) ChangeCosts(factor, -1);
  for (const auto& [v, T] : points) {
    linearization_points_[At(v)] = T;
    factor_.ClearSolution(v);
  }
  for (const int slot : slots) ChangeCosts(factor_.FactorAt(slot), 1);
  report.variables_relinearised += static_cast<int>(points.size());
  return true;
}

// Moves the linearisation points of outgrown poses to their estimates. A wrong or far link can throw an estimate to
// where the linearisation means nothing; there the points go only part of the way.
template <class Pose>
void IncrementalSolver<Pose>::RelinearizeOutgrown(StepReport& report) {
  std::map<int, Pose> points;
  for (const int v : outgrown_) {
    if (ExceedsTolerance(v)) points.emplace(v, EstimateAt(v));
  }
  if (points.empty()) return;
  Replacements replaced;
  {
    ScopedTimer timer(seconds_.linearise);
    replaced = LinearizeAround(points);
    double before = static_cast<double>(B * replaced.size());
    for (const auto& change : replaced) before += factor_.FactorAt(change.first).residual.squaredNorm();
    for (double share = 1; share >= kLeastShare; share /= 2) {
      double after = 0;
      for (const auto& change : replaced) after += change.second.residual.squaredNorm();
      if (after <= kClimb * before) break;
      for (auto& [v, T] : points) {
        const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(v) * B);
        T = linearization_points_[At(v)].Retract(share / 2 * d);
      }
      replaced = LinearizeAround(points);
    }
  }
  Relinearize(points, std::move(replaced), report);
}

template <class Pose>
void IncrementalSolver<Pose>::OptimizeOffsets(Clock::time_point, StepReport& report) {
  const auto urgent = [&](int v) { return ExceedsTolerance(v, kUrgent); };
  if (updates_ % options_.relinearize_interval == 0 || std::any_of(outgrown_.begin(), outgrown_.end(), urgent)) {
    RelinearizeOutgrown(report);
  }
  BackSubstitute(report);
  report.iterations = 1;
}

template <class Pose>
void IncrementalSolver<Pose>::BackSubstitute(StepReport& report) {
  ScopedTimer timer(seconds_.solve);
  const std::vector<int> moved = factor_.Solve(options_.propagation_threshold);
  linear_cost_ = LinearMinimum();
  report.variables_moved += static_cast<int>(moved.size());
  for (const int v : moved) {
    if (is_outgrown_[At(v)] != 0 || !ExceedsTolerance(v)) continue;
    is_outgrown_[At(v)] = 1;
    outgrown_.push_back(v);
  }
  // Those that shrank again, by themselves or by relinearisation, leave the list.
  const auto stays = [&](int v) { return ExceedsTolerance(v); };
  const auto end = std::stable_partition(outgrown_.begin(), outgrown_.end(), stays);
  for (auto it = end; it != outgrown_.end(); ++it) is_outgrown_[At(*it)] = 0;
  outgrown_.erase(end, outgrown_.end());
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template LinearFactor<Pose::kDof> IncrementalSolver<Pose>::LinearizeSlot(int, const PointOf&) const;                \
  template IncrementalSolver<Pose>::Replacements IncrementalSolver<Pose>::LinearizeAround(const std::map<int, Pose>&) \
      const;                                                                                                          \
  template bool IncrementalSolver<Pose>::Relinearize(const std::map<int, Pose>&, Replacements, StepReport&);          \
  template void IncrementalSolver<Pose>::OptimizeOffsets(Clock::time_point, StepReport&);                             \
  template void IncrementalSolver<Pose>::BackSubstitute(StepReport&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
