// The course of a step, and what can be asked between steps.

#include "terse/core/incremental_solver.h"

#include <cmath>
#include <stdexcept>

#include "incremental/incremental_plan.h"
#include "support/stopwatch.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::Log;
using internal::ScopedTimer;
using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

const char* NameForLog(FactorPath path) {
  switch (path) {
    case FactorPath::kNone: return "unchanged";
    case FactorPath::kAppended: return "appended";
    case FactorPath::kRankUpdate: return "updated by rank k";
    case FactorPath::kRefactored: return "reordered and refactored";
  }
  return "unknown";
}

}  // namespace

template <class Pose>
IncrementalSolver<Pose>::IncrementalSolver(const IncrementalOptions& options) : options_(options) {
  const std::string defect = FindDefect(options);
  if (!defect.empty()) throw std::invalid_argument("incremental options: " + defect);
  factor_.SetThreads(options.threads);
  if (IsRobust()) width_ = WidthOf(options.robust, B);
}

template <class Pose>
StepReport IncrementalSolver<Pose>::Update(const GraphUpdate<Pose>& update) {
  const auto start = Clock::now();
  const bool was_deferred = deferred_;
  StepReport report;
  Validate(update);
  Plan plan;
  {
    ScopedTimer timer(seconds_.linearise);
    PlanNewPoses(update, plan);
    PlanFrame(update, plan);
    PlanFactors(update, plan);
    PlanAnchor(update, plan);
  }
  const GateValues before = ValuesForGate();
  const double minimum_before = LinearMinimum();
  AddToFactor(update, plan, report);
  if (IsRobust()) AdmitNewLoops(plan, report);
  const double minimum_after = LinearMinimum();
  DecideGate(update, plan, before, report);
  const bool report_cost = options_.report_cost && options_.carry == Carry::kOffset;
  if (report_cost) report.actual_decrease = TimedChi2(report);
  const int new_poses = static_cast<int>(update.poses.size());
  if (options_.carry == Carry::kPoint) {
    MovePoints(new_poses, start, report);
  } else if (!report.gate_open) {
    ScopedTimer timer(seconds_.solve);
    PlaceNewPoses(new_poses, report);
  } else {
    OptimizeOffsets(start, report);
  }
  if (IsRobust()) ReviewLoops(start, report);
  if (MayRestart()) WatchStep(minimum_before, minimum_after, report);
  if (report_cost) report.actual_decrease -= TimedChi2(report);
  report.seconds += std::chrono::duration<double>(Clock::now() - start).count();
  LogStep(update, report, was_deferred);
  return report;
}

template <class Pose>
void IncrementalSolver<Pose>::LogStep(const GraphUpdate<Pose>& update, const StepReport& report,
                                      bool was_deferred) const {
  if (!options_.log) return;
  Log(options_.log, LogLevel::kDebug, "step ", updates_, ": ", update.poses.size(), " poses, ", update.factors.size(),
      " factors, ", update.removed.size(), " removed; factor ", NameForLog(report.path), " (",
      report.variables_refactored, " of ", factor_.Variables(), " poses refactored), gain ", report.gain_nats,
      " nats; gate ", report.gate_open ? "open" : "closed", " at ", report.gate_value, " (threshold ",
      options_.gate_threshold, "); ", report.iterations, " iterations, ", report.variables_relinearised,
      " relinearised, ", report.variables_moved, " moved");
  if (deferred_ && !was_deferred) {
    Log(options_.log, LogLevel::kInfo, "step ", updates_, ": over its budget, ", report.deferred_relinearisations,
        " relinearisations and ", report.deferred_fronts, " subtrees are left to later steps");
  }
  if (!deferred_ && was_deferred) {
    Log(options_.log, LogLevel::kInfo, "step ", updates_, ": the work left by earlier steps is done");
  }
}

// Chi2, its time taken off the step's.
template <class Pose>
double IncrementalSolver<Pose>::TimedChi2(StepReport& report) const {
  const auto start = Clock::now();
  const double chi2 = Chi2();
  report.seconds -= std::chrono::duration<double>(Clock::now() - start).count();
  return chi2;
}

template <class Pose>
void IncrementalSolver<Pose>::AddToFactor(const GraphUpdate<Pose>& update, Plan& plan, StepReport& report) {
  std::vector<LinearFactor<B>> gone;
  for (const int slot : plan.changes.removed) gone.push_back(factor_.FactorAt(slot));
  for (const auto& change : plan.changes.replaced) gone.push_back(factor_.FactorAt(change.first));
  const auto factored = UpdateFactor(plan.changes, report);
  if (!factored.ok) ThrowSingularUpdate(update, plan, factored.failed_variable);
  report.path = factored.path;
  for (const auto& factor : gone) ChangeCosts(factor, -1);
  for (const auto& change : plan.changes.replaced) ChangeCosts(change.second, 1);
  for (const auto& factor : plan.changes.added) ChangeCosts(factor, 1);
  Commit(update, plan, report, factored.added_slots);
  if (!plan.moved_points.empty()) RecountCosts();  // the offsets are gone
}

// Of the system that the update would have made.
template <class Pose>
void IncrementalSolver<Pose>::ThrowSingularUpdate(const GraphUpdate<Pose>& update, const Plan& plan,
                                                  int failed_variable) const {
  std::map<int, LinearFactor<B>> old;
  for (int slot = 0; slot < static_cast<int>(factor_of_slot_.size()); ++slot) {
    if (factor_.FactorAt(slot).first >= 0) old.emplace(slot, factor_.FactorAt(slot));
  }
  for (const int slot : plan.changes.removed) old.erase(slot);
  for (const auto& [slot, factor] : plan.changes.replaced) old[slot] = factor;
  std::vector<LinearFactor<B>> system = plan.changes.added;
  for (const auto& [slot, factor] : old) system.push_back(factor);
  std::vector<Pose> values = plan.moved_points.empty() ? linearization_points_ : plan.moved_points;
  values.insert(values.end(), plan.new_values.begin(), plan.new_values.end());
  std::vector<PoseId> ids;
  for (const auto& node : graph_.Poses()) ids.push_back(node.id);
  for (const auto& pose : update.poses) ids.push_back(pose.id);
  SingularityReport report = ExplainSingularity(std::move(system), values, ids, failed_variable);
  report.message = "the update cannot be made: " + report.message;
  ThrowSingular(std::move(report));
}

template <class Pose>
typename BlockCholesky<IncrementalSolver<Pose>::B>::UpdateReport IncrementalSolver<Pose>::UpdateFactor(
    typename BlockCholesky<B>::Changes changes, StepReport& report) {
  typename BlockCholesky<B>::UpdateReport factored;
  {
    ScopedTimer timer(seconds_.factor);
    factored = factor_.Update(std::move(changes));
  }
  seconds_.order += factored.seconds_order;
  seconds_.factor -= factored.seconds_order;
  report.fronts_updated += factored.fronts_updated;
  report.fronts_refactored += factored.fronts;
  report.variables_refactored += factored.variables;
  report.flops += factored.flops;
  return factored;
}

template <class Pose>
Pose IncrementalSolver<Pose>::EstimateAt(int index) const {
  const Eigen::Map<const Vector<B>> d(factor_.Solution().data() + At(index) * B);
  return linearization_points_.at(At(index)).Retract(d);
}

template <class Pose>
std::vector<Pose> IncrementalSolver<Pose>::Estimates() const {
  std::vector<Pose> out;
  out.reserve(linearization_points_.size());
  for (int v = 0; v < static_cast<int>(linearization_points_.size()); ++v) out.push_back(EstimateAt(v));
  return out;
}

template <class Pose>
double IncrementalSolver<Pose>::Chi2() const {
  const std::vector<Pose> estimates = Estimates();
  double chi2 = 0;
  for (const auto& node : graph_.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    chi2 +=
        FactorChi2(node.factor, estimates[At(graph_.IndexOf(ends.first))], estimates[At(graph_.IndexOf(ends.second))]);
  }
  return chi2;
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::FinishFrom(const std::vector<Pose>& T_world_body,
                                                      const BatchOptions& given) {
  BatchOptions options = given;
  if (!options.log) options.log = options_.log;
  BatchResult<Pose> result =
      IsRobust() ? SolveRobustBatch(T_world_body, options) : SolveBatch(graph_, T_world_body, options);
  if (result.termination == Termination::kNotPositiveDefinite) return result;
  if (IsRobust()) TakeWeights(result.weights);
  // The factor of this solver moves to the optimum too: every linearisation point changes.
  const double before = LinearMinimum();
  if (!MoveTo(result.T_world_body)) throw NumericalError("the system is singular at the optimum");
  watch_.corrected += std::abs(LinearMinimum() - before);
  return result;
}

template class IncrementalSolver<SE2>;
template class IncrementalSolver<SE3>;

}  // namespace terse
