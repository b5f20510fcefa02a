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
// A step that lowers chi2 by this share may move the map so far that relinearisation does not wait for the interval;
// it does not if the linearisation errors are this many times what is tolerated.
const double kUrgent = getenv("U") ? atof(getenv("U")) : 1e-2, kUrgentError = getenv("UE") ? atof(getenv("UE")) : 10;

}  // namespace

template <class Pose>
bool IncrementalSolver<Pose>::IsOutgrown(int variable) const {
  const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(variable) * B);
  return d.template head<Pose::kDim>().norm() > options_.relinearize_metres ||
         d.template tail<B - Pose::kDim>().norm() > options_.relinearize_radians;
}

// How far the linearised factor is from the true one, in units of chi2.
template <class Pose>
double IncrementalSolver<Pose>::LinearizationError(int slot) const {
  const LinearFactor<B>& f = factor_.FactorAt(slot);
  const FactorId id = factor_of_slot_[At(slot)];
  if (f.first < 0 || id.value < 0) return 0;
  Vector<B> linear = f.residual;
  linear += f.A_first * Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(f.first) * B);
  if (f.second >= 0) {
    linear += f.A_second * Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(f.second) * B);
  }
  const Pose first = EstimateAt(f.first);
  const Vector<B> actual =
      Residual(graph_.FindFactor(id)->factor, first, f.second >= 0 ? EstimateAt(f.second) : first);
  return (W_of_slot_[At(slot)] * actual - linear).squaredNorm();
}

// Of the factors on poses that moved.
template <class Pose>
void IncrementalSolver<Pose>::UpdateLinearizationErrors() {
  std::vector<int> slots;
  for (const int v : moved_) {
    is_moved_[At(v)] = 0;
    for (const int slot : factor_.SlotsOf(v)) {
      if (std::exchange(is_listed_[At(slot)], 1) == 0) slots.push_back(slot);
    }
  }
  moved_.clear();
  for (const int slot : slots) {
    is_listed_[At(slot)] = 0;
    SetLinearizationError(slot, LinearizationError(slot));
  }
}

template <class Pose>
void IncrementalSolver<Pose>::SetLinearizationError(int slot, double error) {
  if (IsSuspicious(error) && std::exchange(is_suspect_[At(slot)], 1) == 0) suspects_.push_back(slot);
  error_sum_ += error - error_of_slot_[At(slot)];
  error_of_slot_[At(slot)] = error;
}

// The poses of the worst factors, so many that what is left is half of what is tolerated.
template <class Pose>
std::map<int, Pose> IncrementalSolver<Pose>::PosesToRelinearize(double times) {
  UpdateLinearizationErrors();
  const double tolerated = options_.relinearize_tolerance * CostUnit();
  std::map<int, Pose> points;
  if (error_sum_ <= times * tolerated) return points;
  const auto is_clear = [&](int slot) { return !IsSuspicious(error_of_slot_[At(slot)]); };
  for (const int slot : suspects_) is_suspect_[At(slot)] = is_clear(slot) ? 0 : 1;
  suspects_.erase(std::remove_if(suspects_.begin(), suspects_.end(), is_clear), suspects_.end());
  std::sort(suspects_.begin(), suspects_.end(), [&](int a, int b) {
    return std::make_pair(-error_of_slot_[At(a)], a) < std::make_pair(-error_of_slot_[At(b)], b);
  });
  double left = error_sum_;
  for (const int slot : suspects_) {
    if (left <= tolerated / 2) break;
    left -= error_of_slot_[At(slot)];
    const LinearFactor<B>& f = factor_.FactorAt(slot);
    for (const int v : {f.first, f.second}) {
      if (v >= 0 && IsOutgrown(v)) points.emplace(v, EstimateAt(v));
    }
  }
  return points;
}

template <class Pose>
LinearFactor<Pose::kDof> IncrementalSolver<Pose>::LinearizeSlot(int slot, const PointOf& point) const {
  const LinearFactor<B>& was = factor_.FactorAt(slot);
  if (slot == anchor_slot_) return was;  // proximal: the same at any value
  const FactorId id = factor_of_slot_[At(slot)];
  const int second = was.second < 0 ? was.first : was.second;
  if (id.value >= 0) {
    return Linearize(graph_.FindFactor(id)->factor, W_of_slot_[At(slot)], was.first, second, point(was.first), point(second));
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
  for (const int slot : slots) {
    ChangeCosts(factor_.FactorAt(slot), 1);
    SetLinearizationError(slot, options_.carry == Carry::kOffset ? LinearizationError(slot) : 0);
  }
  report.variables_relinearised += static_cast<int>(points.size());
  return true;
}

// Moves the linearisation points of the poses with the worst factors to their estimates. A wrong or far link can throw an estimate to
// where the linearisation means nothing; there the points go only part of the way.
template <class Pose>
bool IncrementalSolver<Pose>::RelinearizeWorst(double times, StepReport& report) {
  std::map<int, Pose> points;
  Replacements replaced;
  {
    ScopedTimer timer(seconds_.linearise);
    points = PosesToRelinearize(times);
    if (points.empty()) return false;
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
  return Relinearize(points, std::move(replaced), report);
}

template <class Pose>
void IncrementalSolver<Pose>::OptimizeOffsets(Clock::time_point, StepReport& report) {
  if (updates_ % options_.relinearize_interval == 0) RelinearizeWorst(1, report);
  do {
    const double decrease = RemainingDecrease();
    BackSubstitute(report);
    ++report.iterations;
    if (decrease < kUrgent * CostUnit() || report.iterations >= options_.max_iterations) break;
  } while (RelinearizeWorst(kUrgentError, report));
}

template <class Pose>
void IncrementalSolver<Pose>::BackSubstitute(StepReport& report) {
  ScopedTimer timer(seconds_.solve);
  const std::vector<int> moved = factor_.Solve(options_.propagation_tolerance * CostUnit());
  linear_cost_ = LinearMinimum();
  report.solve_flops += factor_.LastSolve().flops;
  report.variables_moved += static_cast<int>(moved.size());
  for (const int v : moved) {
    if (is_moved_[At(v)] != 0 || !IsOutgrown(v)) continue;
    is_moved_[At(v)] = 1;
    moved_.push_back(v);
  }
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
