// Carry::kOffset: estimate = linearisation point + d.

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <unordered_set>

#include "incremental/incremental_plan.h"
#include "support/stopwatch.h"
#include "terse/core/gauge.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::Log;
using internal::ScopedTimer;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// Relinearised factors may cost this many times as much as before (curved valleys climb a little) before the
// points go only part of the way, at least this share of it.
constexpr double kClimb = 4, kLeastShare = 0.05;
// Linearisation errors of so many times what is tolerated do not wait for the interval.
constexpr double kUrgent = 100;
// Shares of what is tolerated: from which on a pose's factors are looked at, and a neighbour joins those that are
// relinearised.
constexpr double kWorthLooking = 1e-2, kWorthJoining = 1e-2;

}  // namespace

template <class Pose>
bool IncrementalSolver<Pose>::IsOutgrown(int variable) const {
  const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(variable) * B);
  return d.template head<Pose::kDim>().norm() > options_.relinearize_metres ||
         d.template tail<B - Pose::kDim>().norm() > options_.relinearize_radians;
}

// A scale for how much the errors of a pose's factors changed since they were looked at: they are products of its turn
// with whatever moves (residuals are linear in the translations alone).
template <class Pose>
double IncrementalSolver<Pose>::PossibleError(int variable) const {
  constexpr int R = B - Pose::kDim;
  const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(variable) * B);
  return d.template tail<R>().squaredNorm() * (d - seen_[At(variable)]).cwiseAbs2().dot(factor_.DiagonalOf(variable));
}

// How far the linearised factor is from the true one, in units of chi2.
template <class Pose>
double IncrementalSolver<Pose>::LinearizationError(int slot) {
  const LinearFactor<B>& f = factor_.FactorAt(slot);
  const FactorId id = factor_of_slot_[At(slot)];
  if (f.first < 0 || id.value < 0) return 0;
  Vector<B> linear = f.residual;
  linear += f.A_first * Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(f.first) * B);
  if (f.second >= 0) {
    linear += f.A_second * Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(f.second) * B);
  }
  return (WhitenedResidualAt(slot) - linear).squaredNorm();
}

// EstimateAt for many factors on the same poses; from one look at the errors to the next.
template <class Pose>
const Pose& IncrementalSolver<Pose>::RememberedEstimate(int index) {
  if (std::exchange(remembered_in_[At(index)], look_) != look_) remembered_[At(index)] = EstimateAt(index);
  return remembered_[At(index)];
}

template <class Pose>
Vector<Pose::kDof> IncrementalSolver<Pose>::WhitenedResidualAt(int slot) {
  const LinearFactor<B>& f = factor_.FactorAt(slot);
  const Pose& first = RememberedEstimate(f.first);
  return W_of_slot_[At(slot)] * Residual(graph_.FindFactor(factor_of_slot_[At(slot)])->factor, first,
                                         f.second >= 0 ? RememberedEstimate(f.second) : first);
}

// Of the factors on poses that moved.
template <class Pose>
void IncrementalSolver<Pose>::UpdateLinearizationErrors() {
  ++look_;
  std::vector<int> slots;
  for (const int v : moved_) {
    possible_of_[At(v)] = 0;
    seen_[At(v)] = Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(v) * B);
    for (const int slot : factor_.SlotsOf(v)) {
      if (std::exchange(is_listed_[At(slot)], 1) == 0) slots.push_back(slot);
    }
  }
  moved_.clear();
  possible_error_ = 0;
  for (const int slot : slots) {
    is_listed_[At(slot)] = 0;
    SetLinearizationError(slot, LinearizationError(slot));
  }
}

// Where every pose is its own linearisation point.
template <class Pose>
void IncrementalSolver<Pose>::ForgetErrors() {
  std::fill(seen_.begin(), seen_.end(), Vector<B>::Zero());
  std::fill(possible_of_.begin(), possible_of_.end(), 0.0);
  std::fill(error_of_slot_.begin(), error_of_slot_.end(), 0.0);
  std::fill(is_suspect_.begin(), is_suspect_.end(), 0);
  moved_.clear();
  suspects_.clear();
  possible_error_ = error_sum_ = 0;
}

template <class Pose>
void IncrementalSolver<Pose>::SetLinearizationError(int slot, double error) {
  if (IsSuspicious(error) && std::exchange(is_suspect_[At(slot)], 1) == 0) suspects_.push_back(slot);
  error_sum_ += error - error_of_slot_[At(slot)];
  error_of_slot_[At(slot)] = error;
}

// The poses of the worst factors, so many that what is left is half of what is tolerated.
template <class Pose>
std::map<int, Pose> IncrementalSolver<Pose>::PosesToRelinearize(double times, std::optional<Clock::time_point> deadline,
                                                                StepReport& report) {
  UpdateLinearizationErrors();
  looked_at_ = updates_;
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
  std::vector<int> added;
  std::unordered_set<int> fronts;
  const double affordable = deadline ? AffordableFlops(*deadline) : std::numeric_limits<double>::infinity();
  double flops = 0;
  report.deferred_relinearisations = 0;
  const auto add = [&](int v) {
    if (v < 0 || !IsOutgrown(v) || points.count(v) != 0) return;
    if (deadline) {
      const double more = PathFlops(v, fronts);
      // A step that brings nothing gets on whatever the budget: what never fits would wait for ever.
      // But not from an estimate that back-substitution has half done.
      const bool must = points.empty() && report.path == FactorPath::kNone && factor_.LastSolve().deferred == 0;
      if (flops + more > affordable && !must) {
        ++report.deferred_relinearisations;
        return;
      }
      flops += more;
      TakePath(v, fronts);
    }
    points.emplace(v, RememberedEstimate(v));
    added.push_back(v);
  };
  for (const int slot : suspects_) {
    if (tolerated > 0 && left <= tolerated / 2) break;
    left -= error_of_slot_[At(slot)];
    add(factor_.FactorAt(slot).first);
    add(factor_.FactorAt(slot).second);
  }
  // Poses that moved together far and fast: a factor between one that is relinearised and one that is not would be
  // linearised where nobody is.
  for (size_t k = 0; k < added.size(); ++k) {
    for (const int slot : factor_.SlotsOf(added[k])) {
      const LinearFactor<B>& f = factor_.FactorAt(slot);
      const int other = f.first == added[k] ? f.second : f.first;
      if (other < 0 || points.count(other) != 0 || !IsOutgrown(other)) continue;
      if (ErrorAfter(slot, points) > kWorthJoining * tolerated) add(other);
    }
  }
  return points;
}

template <class Pose>
double IncrementalSolver<Pose>::AffordableFlops(Clock::time_point deadline) const {
  // Half of the time is for back-substitution and for what the prediction misses.
  return 0.5 * std::chrono::duration<double>(deadline - Clock::now()).count() / seconds_per_flop_;
}

// Of refactoring the fronts from the variable to the root that are not in `fronts` yet.
template <class Pose>
double IncrementalSolver<Pose>::PathFlops(int variable, const std::unordered_set<int>& fronts) const {
  double flops = 0;
  for (int f = factor_.FrontOf(variable); f >= 0 && fronts.count(f) == 0; f = factor_.FrontAt(f).parent) {
    const double rows = factor_.FrontAt(f).Rows(), s = rows - factor_.FrontAt(f).Columns();
    flops += (std::pow(rows, 3) - std::pow(s, 3)) / 3;
  }
  return flops;
}

template <class Pose>
void IncrementalSolver<Pose>::TakePath(int variable, std::unordered_set<int>& fronts) const {
  for (int f = factor_.FrontOf(variable); f >= 0 && fronts.insert(f).second;) f = factor_.FrontAt(f).parent;
}

// The linearisation error of a factor when these poses are relinearised.
template <class Pose>
double IncrementalSolver<Pose>::ErrorAfter(int slot, const std::map<int, Pose>& points) {
  const auto point = [&](int v) -> const Pose& {
    const auto it = points.find(v);
    return it != points.end() ? it->second : linearization_points_[At(v)];
  };
  const LinearFactor<B> f = LinearizeSlot(slot, point);
  Vector<B> linear = f.residual;
  const auto add = [&](int v, const Matrix<B, B>& A) {
    if (v >= 0 && points.count(v) == 0)
      linear += A * Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(v) * B);
  };
  add(f.first, f.A_first);
  add(f.second, f.A_second);
  return (WhitenedResidualAt(slot) - linear).squaredNorm();
}

template <class Pose>
LinearFactor<Pose::kDof> IncrementalSolver<Pose>::LinearizeSlot(int slot, const PointOf& point) const {
  const LinearFactor<B>& was = factor_.FactorAt(slot);
  if (slot == anchor_slot_) return was;  // proximal: the same at any value
  const FactorId id = factor_of_slot_[At(slot)];
  const int second = was.second < 0 ? was.first : was.second;
  if (id.value >= 0) {
    return Linearize(graph_.FindFactor(id)->factor, W_of_slot_[At(slot)], was.first, second, point(was.first),
                     point(second));
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
  if (!UpdateFactor(std::move(changes), report).ok) {
    Log(options_.log, LogLevel::kWarning, "step ", updates_, ": not positive definite at ", points.size(),
        " new linearisation points, the old ones stay");
    return false;
  }
  for (const auto& factor : before) ChangeCosts(factor, -1);
  for (const auto& [v, T] : points) {
    linearization_points_[At(v)] = T;
    factor_.ClearSolution(v);
    seen_[At(v)].setZero();
    if (IsRobust()) touched_.push_back(v);
  }
  ++look_;
  for (const int slot : slots) {
    ChangeCosts(factor_.FactorAt(slot), 1);
    SetLinearizationError(slot, options_.carry == Carry::kOffset ? LinearizationError(slot) : 0);
  }
  report.variables_relinearised += static_cast<int>(points.size());
  return true;
}

// Moves the linearisation points of the poses with the worst factors to their estimates. A wrong or far link can throw
// an estimate to where the linearisation means nothing; there the points go only part of the way.
template <class Pose>
bool IncrementalSolver<Pose>::RelinearizeWorst(double times, std::optional<Clock::time_point> deadline,
                                               StepReport& report) {
  std::map<int, Pose> points;
  Replacements replaced;
  {
    ScopedTimer timer(seconds_.linearise);
    points = PosesToRelinearize(times, deadline, report);
    if (points.empty()) return false;
    replaced = LinearizeAround(points);
    double before = static_cast<double>(B * replaced.size());
    for (const auto& change : replaced) before += factor_.FactorAt(change.first).residual.squaredNorm();
    for (double share = 1; share >= kLeastShare; share /= 2) {
      double after = 0;
      for (const auto& change : replaced) after += change.second.residual.squaredNorm();
      if (after <= kClimb * before) {
        if (share < 1) {
          Log(options_.log, LogLevel::kInfo, "step ", updates_, ": far steps, ", points.size(),
              " linearisation points go only ", share, " of the way");
        }
        break;
      }
      for (auto& [v, T] : points) {
        const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(v) * B);
        T = linearization_points_[At(v)].Retract(share / 2 * d);
      }
      replaced = LinearizeAround(points);
    }
  }
  const auto start = Clock::now();
  std::unordered_set<int> fronts;
  double flops = 0;
  if (deadline) {
    for (const auto& [v, T] : points) {
      flops += PathFlops(v, fronts);
      TakePath(v, fronts);
    }
  }
  if (!Relinearize(points, std::move(replaced), report)) return false;
  if (deadline) {
    const double measured = std::chrono::duration<double>(Clock::now() - start).count() / std::max(flops, 1e3);
    seconds_per_flop_ += 0.3 * (measured - seconds_per_flop_);
  }
  return true;
}

template <class Pose>
void IncrementalSolver<Pose>::OptimizeOffsets(Clock::time_point start, StepReport& report) {
  std::optional<Clock::time_point> deadline;
  if (options_.budget_seconds > 0) {
    deadline =
        start + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(options_.budget_seconds));
  }
  if (IsRelinearizationDue() || deferred_) RelinearizeWorst(1, deadline, report);
  const auto is_urgent = [&] { return possible_error_ > kUrgent * options_.relinearize_tolerance * CostUnit(); };
  do {
    BackSubstitute(deadline, report);
    ++report.iterations;
  } while (report.iterations < options_.max_iterations && is_urgent() && !(deadline && Clock::now() > *deadline) &&
           RelinearizeWorst(kUrgent, deadline, report));
  report.deferred_fronts = factor_.LastSolve().deferred;
  deferred_ = report.deferred_fronts > 0 || report.deferred_relinearisations > 0;
}

template <class Pose>
void IncrementalSolver<Pose>::BackSubstitute(std::optional<Clock::time_point> deadline, StepReport& report) {
  ScopedTimer timer(seconds_.solve);
  const std::vector<int> moved = factor_.Solve(options_.propagation_tolerance * CostUnit(), deadline);
  linear_cost_ = LinearMinimum();
  report.solve_flops += factor_.LastSolve().flops;
  report.variables_moved += static_cast<int>(moved.size());
  if (IsRobust()) touched_.insert(touched_.end(), moved.begin(), moved.end());
  const double worth = kWorthLooking * options_.relinearize_tolerance * CostUnit();
  for (const int v : moved) {
    const double possible = PossibleError(v);
    double& known = possible_of_[At(v)];  // 0: not listed
    if (known == 0 && (!(possible > worth) || !IsOutgrown(v))) continue;
    if (known == 0) moved_.push_back(v);
    possible_error_ += possible - known;
    known = std::max(possible, std::numeric_limits<double>::min());
  }
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template LinearFactor<Pose::kDof> IncrementalSolver<Pose>::LinearizeSlot(int, const PointOf&) const;                \
  template IncrementalSolver<Pose>::Replacements IncrementalSolver<Pose>::LinearizeAround(const std::map<int, Pose>&) \
      const;                                                                                                          \
  template bool IncrementalSolver<Pose>::Relinearize(const std::map<int, Pose>&, Replacements, StepReport&);          \
  template void IncrementalSolver<Pose>::ForgetErrors();                                                              \
  template void IncrementalSolver<Pose>::OptimizeOffsets(Clock::time_point, StepReport&);                             \
  template void IncrementalSolver<Pose>::BackSubstitute(std::optional<Clock::time_point>, StepReport&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
