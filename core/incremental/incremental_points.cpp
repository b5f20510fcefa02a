// Carry::kPoint: the estimate is the linearisation point, and d is zero between steps.

#include <algorithm>
#include <numeric>
#include <unordered_set>

#include "experiments/paper_flops.h"
#include "incremental/incremental_plan.h"
#include "support/stopwatch.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using internal::Log;
using internal::ScopedTimer;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// A rise by less is rounding.
constexpr double kRounding = 1e-12;
// The guard gives a direction up when this share of it still raises chi2.
constexpr double kLeastShare = 1e-3;

template <class Front>
double Entries(const Front& front) {
  const double p = front.Columns(), rows = front.Rows() - 1;
  return p * rows - p * (p - 1) / 2;
}

// The fronts that hold the variables, and all their ancestors; parents first.
template <int B>
std::vector<int> AncestorClosure(const BlockCholesky<B>& factor, const std::vector<int>& variables) {
  std::vector<int> order, path;
  std::unordered_set<int> seen;
  for (const int v : variables) {
    for (int f = factor.FrontOf(v); f >= 0 && seen.insert(f).second; f = factor.FrontAt(f).parent) path.push_back(f);
    order.insert(order.end(), path.rbegin(), path.rend());
    path.clear();
  }
  return order;
}

// Back-substitution on these fronts: their share of the full Gauss-Newton step (A, Eq. 15, which holds for sets that
// are closed under ancestors). Returns the variables.
template <int B>
std::vector<int> SolveOn(BlockCholesky<B>& factor, const std::vector<int>& fronts) {
  std::vector<int> variables;
  Eigen::VectorXd x;
  for (const int f : fronts) {
    const auto& front = factor.FrontAt(f);
    const int rows = front.Rows(), p = front.Columns();
    const Eigen::Map<const Eigen::MatrixXd> L(front.panel.data(), rows, p);
    x = L.row(rows - 1).transpose();
    int row = p;
    for (const int v : front.separators) {
      const Eigen::Map<const Vector<B>> xs(factor.Solution().data() + At(v) * B);
      x.noalias() -= L.template middleRows<B>(row).transpose() * xs;
      row += B;
    }
    L.topRows(p).template triangularView<Eigen::Lower>().transpose().solveInPlace(x);
    row = 0;
    for (const int v : front.pivots) {
      factor.SetSolution(v, x.segment<B>(row));
      variables.push_back(v);
      row += B;
    }
  }
  return variables;
}

template <int B>
double SquaredResiduals(const std::vector<std::pair<int, LinearFactor<B>>>& replacements) {
  double sum = 0;
  for (const auto& change : replacements) sum += change.second.residual.squaredNorm();
  return sum;
}

}  // namespace

template <class Pose>
bool IncrementalSolver<Pose>::ExceedsStepTolerance(const Vector<B>& d) const {
  return d.template head<Pose::kDim>().norm() > options_.step_metres ||
         d.template tail<B - Pose::kDim>().norm() > options_.step_radians;
}

// The Gauss-Newton step of the variables in scope (null: of all that propagation reaches).
template <class Pose>
typename IncrementalSolver<Pose>::Steps IncrementalSolver<Pose>::SolveSteps(const std::vector<int>* scope,
                                                                            StepReport& report) {
  ScopedTimer timer(seconds_.solve);
  std::vector<int> solved, fronts;
  if (scope == nullptr) {
    solved = factor_.Solve(options_.propagation_tolerance * CostUnit());
    report.solve_flops += factor_.LastSolve().flops;
  } else {
    fronts = AncestorClosure(factor_, *scope);
    solved = SolveOn(factor_, fronts);
  }
  for (const int f : fronts) report.solve_flops += 2 * Entries(factor_.FrontAt(f));
  Steps steps;
  for (const int v : scope == nullptr ? solved : *scope) {
    steps.emplace(v, Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(v) * B));
  }
  for (const int v : solved) factor_.ClearSolution(v);
  return steps;
}

// Moves the linearisation points by the steps; by others, given back, if the guard finds that chi2 would rise. False
// if no step lowers it, or the factor does not take any.
template <class Pose>
bool IncrementalSolver<Pose>::MoveBy(Steps& steps, StepReport& report) {
  std::map<int, Pose> points;
  Replacements replaced;
  double before = 0, after = 0;
  const auto place = [&](double share) {
    ScopedTimer timer(seconds_.linearise);
    points.clear();
    for (const auto& [v, d] : steps) points.emplace(v, linearization_points_[At(v)].Retract(share * d));
    replaced = LinearizeAround(points);
    before = 0;
    for (const auto& change : replaced) before += factor_.FactorAt(change.first).residual.squaredNorm();
    after = SquaredResiduals(replaced);
    return after <= before * (1 + kRounding);
  };
  bool good = place(1);
  if (options_.guard && !good) {
    if (report.gate_open && static_cast<int>(steps.size()) < factor_.Variables()) {
      std::vector<int> all(At(factor_.Variables()));
      std::iota(all.begin(), all.end(), 0);
      steps = SolveSteps(&all, report);
      good = place(1);
      Log(options_.log, LogLevel::kDebug, "step ", updates_, ": its part would raise chi2, the full step",
          good ? " is taken" : " too");
    }
    double share = 1;
    while (!good && share / 2 >= kLeastShare) good = place(share /= 2);
    if (!good) {
      Log(options_.log, LogLevel::kInfo, "step ", updates_, ": no part of the step lowers chi2, it is not taken");
      return false;
    }
    if (share < 1) Log(options_.log, LogLevel::kDebug, "step ", updates_, ": shortened to ", share, " of itself");
  }
  if (!Relinearize(points, std::move(replaced), report)) return false;
  report.actual_decrease += before - after;
  return true;
}

// The poses of the next iteration: those that moved, and their neighbours (A, Eqs. 17-18).
template <class Pose>
std::vector<int> IncrementalSolver<Pose>::NextScope(const Steps& moved, bool neighbours) const {
  std::vector<int> scope;
  for (const auto& step : moved) {
    scope.push_back(step.first);
    if (!neighbours) continue;
    for (const int slot : factor_.SlotsOf(step.first)) {
      const LinearFactor<B>& f = factor_.FactorAt(slot);
      scope.push_back(f.first);
      if (f.second >= 0) scope.push_back(f.second);
    }
  }
  std::sort(scope.begin(), scope.end());
  scope.erase(std::unique(scope.begin(), scope.end()), scope.end());
  return scope;
}

template <class Pose>
void IncrementalSolver<Pose>::MovePoints(int new_poses, Clock::time_point start, StepReport& report) {
  const int variables = factor_.Variables();
  const bool everything = report.gate_open;
  std::vector<int> scope;  // once it is not everything
  if (!everything) {
    report.predicted_decrease = 0;
    scope.resize(At(new_poses));
    std::iota(scope.begin(), scope.end(), variables - new_poses);
  }
  internal::PaperFlops paper;
  if (options_.report_paper_flops) {
    double seconds = 0;
    {
      ScopedTimer timer(seconds);
      paper = internal::PaperFlops(factor_);
    }
    report.seconds -= seconds;
    report.paper_update_flops = paper.Added(variables - new_poses);
  }
  deferred_ = false;
  bool all = everything;
  std::vector<int> moved;
  for (int k = 0; k < options_.max_iterations && (all || !scope.empty()); ++k) {
    Steps steps = SolveSteps(all ? nullptr : &scope, report);
    if (options_.report_paper_flops) report.paper_solve_flops += all ? paper.Solved() : paper.Solved(scope);
    const auto exceeds = [&](const auto& step) { return ExceedsStepTolerance(step.second); };
    const auto outgrown = std::count_if(steps.begin(), steps.end(), exceeds);
    if (outgrown == 0) break;
    if (options_.budget_seconds > 0 &&
        std::chrono::duration<double>(Clock::now() - start).count() > options_.budget_seconds) {
      report.deferred_relinearisations = static_cast<int>(outgrown);
      deferred_ = true;
      break;
    }
    if (options_.partial) {
      for (auto it = steps.begin(); it != steps.end();) it = exceeds(*it) ? std::next(it) : steps.erase(it);
    }
    if (!MoveBy(steps, report)) break;
    ++report.iterations;
    for (const auto& step : steps) moved.push_back(step.first);
    if (options_.report_paper_flops) {
      report.paper_update_flops += all && !options_.partial ? paper.Updated() : paper.Updated(NextScope(steps, false));
    }
    if (options_.partial) {
      scope = NextScope(steps, options_.partial_neighbours && everything);
      all = false;
    }
  }
  std::sort(moved.begin(), moved.end());
  report.variables_moved = static_cast<int>(std::unique(moved.begin(), moved.end()) - moved.begin());
}

#define TERSE_INSTANTIATE(Pose)                                                                                      \
  template bool IncrementalSolver<Pose>::ExceedsStepTolerance(const Vector<B>&) const;                               \
  template IncrementalSolver<Pose>::Steps IncrementalSolver<Pose>::SolveSteps(const std::vector<int>*, StepReport&); \
  template bool IncrementalSolver<Pose>::MoveBy(Steps&, StepReport&);                                                \
  template std::vector<int> IncrementalSolver<Pose>::NextScope(const Steps&, bool) const;                            \
  template void IncrementalSolver<Pose>::MovePoints(int, Clock::time_point, StepReport&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
