// Carry::kPoint: the estimate is the linearisation point, and d is zero between steps.

#include <algorithm>
#include <numeric>

#include "incremental/steps.h"
#include "support/stopwatch.h"
#include "terse/core/at.h"
#include "terse/core/log_message.h"

namespace terse::internal {
namespace {

using std::size_t;

// A rise by less is rounding.
constexpr double kRoundingOfCost = 1e-12;
// The guard gives a direction up when this share of it still raises chi2.
constexpr double kLeastShareOfStep = 1e-3;

template <class Pose>
typename LinearizedGraph<Pose>::Steps TakeStep(const std::vector<int>* scope, StepContext<Pose>& step) {
  return step.map.TakeStep(scope, step.options.propagation_tolerance * step.map.CostUnit(), step.report);
}

// Moves the linearisation points by the steps; by others, given back, if the guard finds that chi2 would rise. False
// if no step lowers it, or the Cholesky factor does not take any.
template <class Pose>
bool MoveBy(typename LinearizedGraph<Pose>::Steps& steps, StepContext<Pose>& step) {
  LinearizedGraph<Pose>& map = step.map;
  const LogSink& log = step.options.log;
  PointMap<Pose> points;
  typename LinearizedGraph<Pose>::Replacements replaced;
  double before = 0, after = 0;
  const auto place = [&](double share) {
    ScopedTimer timer(map.Seconds().linearise);
    points = {};
    for (const auto& [v, d] : steps) points.Add(v, map.Points()[At(v)].Retract(share * d));
    replaced = map.LinearizeAround(points);
    before = 0;
    for (const auto& change : replaced) before += map.Cholesky().LinearFactorAt(change.first).residual.squaredNorm();
    after = SquaredResiduals(replaced);
    return after <= before * (1 + kRoundingOfCost);
  };
  bool good = place(1);
  if (step.options.guard && !good) {
    if (step.report.gate_open && static_cast<int>(steps.size()) < map.Cholesky().Variables()) {
      std::vector<int> all(At(map.Cholesky().Variables()));
      std::iota(all.begin(), all.end(), 0);
      steps = TakeStep(&all, step);
      good = place(1);
      Log(log, LogLevel::kDebug, "step ", map.Updates(), ": its part would raise chi2, the full step",
          good ? " is taken" : " too");
    }
    double share = 1;
    while (!good && share / 2 >= kLeastShareOfStep) good = place(share /= 2);
    if (!good) {
      Log(log, LogLevel::kInfo, "step ", map.Updates(), ": no part of the step lowers chi2, it is not taken");
      return false;
    }
    if (share < 1) Log(log, LogLevel::kDebug, "step ", map.Updates(), ": shortened to ", share, " of itself");
  }
  if (!step.relinearization.MovePoints(points, std::move(replaced), map, step.options, step.report)) return false;
  step.report.actual_decrease += before - after;
  return true;
}

// The poses of the next iteration: those that moved, and their neighbours (Arablouei 2026 Eqs. 17-18).
template <class Steps, int B>
std::vector<int> NextScope(const Steps& moved, const BlockCholesky<B>& cholesky, bool neighbours) {
  std::vector<int> scope;
  for (const auto& step : moved) {
    scope.push_back(step.first);
    if (!neighbours) continue;
    for (const int slot : cholesky.SlotsOf(step.first)) {
      const LinearFactor<B>& f = cholesky.LinearFactorAt(slot);
      scope.push_back(f.first);
      if (f.second >= 0) scope.push_back(f.second);
    }
  }
  std::sort(scope.begin(), scope.end());
  scope.erase(std::unique(scope.begin(), scope.end()), scope.end());
  return scope;
}

template <class Pose>
bool ExceedsStepTolerance(const Vector<Pose::kDof>& d, const IncrementalOptions& options) {
  return d.template head<Pose::kDim>().norm() > options.step_metres ||
         d.template tail<Pose::kDof - Pose::kDim>().norm() > options.step_radians;
}

template <class Pose>
void Tell(const PointWork& work, StepContext<Pose>& step) {
  double seconds = 0;
  {
    ScopedTimer timer(seconds);
    step.options.on_point_work(work);
  }
  step.report.seconds -= seconds;
}

}  // namespace

template <class Pose>
bool OptimizePoints(int new_poses, StepContext<Pose>& step) {
  const IncrementalOptions& options = step.options;
  const BlockCholesky<Pose::kDof>& cholesky = step.map.Cholesky();
  StepReport& report = step.report;
  const int variables = cholesky.Variables();
  const bool everything = report.gate_open;
  std::vector<int> scope;  // once it is not everything
  if (!everything) {
    report.predicted_decrease = 0;
    scope.resize(At(new_poses));
    std::iota(scope.begin(), scope.end(), variables - new_poses);
  }
  const bool is_watched = static_cast<bool>(options.on_point_work);
  if (is_watched) Tell({PointWork::Kind::kEntered, variables - new_poses, nullptr}, step);
  bool is_deferred = false, all = everything;
  std::vector<int> moved;
  for (int k = 0; k < options.max_iterations && (all || !scope.empty()); ++k) {
    auto steps = TakeStep(all ? nullptr : &scope, step);
    if (is_watched) Tell({PointWork::Kind::kSolved, 0, all ? nullptr : &scope}, step);
    const auto exceeds = [&](const auto& move) { return ExceedsStepTolerance<Pose>(move.second, options); };
    const auto outgrown = std::count_if(steps.begin(), steps.end(), exceeds);
    if (outgrown == 0) break;
    if (step.IsOverBudget()) {
      report.deferred_relinearisations = static_cast<int>(outgrown);
      is_deferred = true;
      break;
    }
    if (options.partial) {
      for (auto it = steps.begin(); it != steps.end();) it = exceeds(*it) ? std::next(it) : steps.erase(it);
    }
    if (!MoveBy(steps, step)) break;
    ++report.iterations;
    for (const auto& move : steps) moved.push_back(move.first);
    if (is_watched) {
      const bool is_whole = all && !options.partial;
      const std::vector<int> relinearised = is_whole ? std::vector<int>() : NextScope(steps, cholesky, false);
      Tell({PointWork::Kind::kRelinearised, 0, is_whole ? nullptr : &relinearised}, step);
    }
    if (options.partial) {
      scope = NextScope(steps, cholesky, options.partial_neighbours && everything);
      all = false;
    }
  }
  std::sort(moved.begin(), moved.end());
  report.variables_moved = static_cast<int>(std::unique(moved.begin(), moved.end()) - moved.begin());
  return is_deferred;
}

template bool OptimizePoints(int, StepContext<SE2>&);
template bool OptimizePoints(int, StepContext<SE3>&);

}  // namespace terse::internal
