// The course of a step, and what can be asked between steps.

#include "terse/core/incremental_solver.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <optional>
#include <stdexcept>

#include "incremental/gate.h"
#include "incremental/loop_judge.h"
#include "incremental/loop_selection.h"
#include "incremental/minimum_watch.h"
#include "incremental/steps.h"
#include "support/stopwatch.h"
#include "terse/core/error.h"
#include "terse/core/hanging_loops.h"
#include "terse/core/initial_values.h"
#include "terse/core/log_message.h"
#include "terse/core/observability.h"
#include "terse/core/open_loops.h"
#include "terse/core/state_members.h"

namespace terse {
namespace {
// Looks at the loops that are out, each time from a new minimum.
constexpr int kMostFinishRounds = 10, kMostVainRounds = 2;
// What falls by less is where it was.
constexpr double kSameCost = 1e-6;
// Before the last round: with wrong loops in, a solver creeps, and what is judged need not be that near.
constexpr int kIterationsOfRound = 20;
// A step without loops that still expects to lower the cost by so many loops: the steps lead nowhere.
constexpr double kDiverging = 1e3;
constexpr double kSameMinimum = 1e-3;
// Of the loops: more than the tail of true ones.
constexpr double kManyOut = 0.05;
// Loops that go at once; and by how much they have to have raised the minimum that they leave. Of two that are nearer
// either may be the better one when more loops come.
constexpr int kGroup = 2;
constexpr double kTrapped = 2;
// What a restart or a rescue takes, about, in relinearisations of everything.
constexpr int kRestartRounds = 30;
// With a budget that it may exceed, a map is rescued at every so many steps at most.
constexpr long kRescueEvery = 10;
// Of a second of the budget: a fresh order that takes more is a step of its own.
constexpr double kFlopsPerSecond = 1e9;

using internal::Log;
using internal::ScopedTimer;

const char* NameForLog(CholeskyPath path) {
  switch (path) {
    case CholeskyPath::kNone: return "unchanged";
    case CholeskyPath::kAppended: return "appended";
    case CholeskyPath::kRankUpdate: return "updated by rank k";
    case CholeskyPath::kRefactored: return "reordered and refactored";
  }
  return "unknown";
}

bool MayRestart(const IncrementalOptions& options) {
  return options.restart && options.carry == Carry::kOffset && options.robust.kernel == RobustKernel::kNone;
}

}  // namespace

template <class Pose>
struct IncrementalSolver<Pose>::Parts {
  using Step = internal::StepContext<Pose>;
  internal::LinearizedGraph<Pose> map;
  internal::Relinearization<Pose> relinearization;
  internal::UpdateGate<Pose> gate;
  internal::LoopJudge<Pose> judge;
  internal::MinimumWatch<Pose> watch;
  bool is_deferred = false;  // work is left from earlier steps

  void Add(const GraphUpdate<Pose>& update, const internal::UpdatePlan<Pose>& plan, const IncrementalOptions& options,
           StepReport& report);
  std::optional<BatchResult<Pose>> SelectAnew(const BatchResult<Pose>& finished, const BatchOptions& given,
                                              const IncrementalOptions& options) const;
  std::optional<BatchResult<Pose>> LetGoHanging(const BatchResult<Pose>& finished, const BatchOptions& given,
                                                const IncrementalOptions& options) const;
  BatchResult<Pose> TakeOptimum(BatchResult<Pose> result, const IncrementalOptions& options);
  [[noreturn]] void ThrowSingularUpdate(const GraphUpdate<Pose>& update, const internal::UpdatePlan<Pose>& plan,
                                        int failed_variable) const;
  void LogFrame(const internal::MapFrame<Pose>& before, bool has_moved, const IncrementalOptions& options) const;
  void LogStep(const GraphUpdate<Pose>& update, const StepReport& report, bool was_deferred,
               const IncrementalOptions& options) const;
  double TimedChi2(StepReport& report) const;
  bool MayTakeLong(const IncrementalOptions& options) const {
    return options.budget_seconds == 0 ||
           internal::Relinearization<Pose>::IsQuick(map, options.budget_seconds, kRestartRounds);
  }
  bool MoveTo(const std::vector<Pose>& T_world_body, const IncrementalOptions& options);
  void RestartIfLower(Step& step);
  void RestartWithoutEvicted(Step& step);
  bool TakeRestart(const BatchResult<Pose>& lower, Step& step);
  void RescueIfDiverging(const internal::UpdatePlan<Pose>& plan, Step& step);
};

template <class Pose>
IncrementalSolver<Pose>::IncrementalSolver(const IncrementalOptions& options)
    : options_(options), parts_(std::make_unique<Parts>()) {
  const std::string defect = FindDefect(options);
  if (!defect.empty()) throw std::invalid_argument("incremental options: " + defect);
  parts_->map.SetThreads(options.threads);
  parts_->map.LimitReordering(kFlopsPerSecond * options.budget_seconds);
  parts_->judge = internal::LoopJudge<Pose>(options.robust);
  if (options.robust.kernel != RobustKernel::kNone) parts_->map.WatchPoses();
}

template <class Pose>
IncrementalSolver<Pose>::IncrementalSolver(const IncrementalSolver& other)
    : options_(other.options_), parts_(std::make_unique<Parts>(*other.parts_)) {}
template <class Pose>
IncrementalSolver<Pose>::IncrementalSolver(IncrementalSolver&&) noexcept = default;
template <class Pose>
IncrementalSolver<Pose>& IncrementalSolver<Pose>::operator=(IncrementalSolver other) noexcept {
  options_ = std::move(other.options_);
  if (parts_ == nullptr || other.parts_ == nullptr) {
    parts_ = std::move(other.parts_);
  } else {
    *parts_ = std::move(*other.parts_);  // covariances refer to the Cholesky factor where it is
  }
  return *this;
}
template <class Pose>
IncrementalSolver<Pose>::~IncrementalSolver() = default;

template <class Pose>
StepReport IncrementalSolver<Pose>::Update(const GraphUpdate<Pose>& update) {
  StepReport report;
  auto& [map, relinearization, gate, judge, watch, is_deferred] = *parts_;
  typename Parts::Step step{options_, map, relinearization, report};
  const bool was_deferred = is_deferred;
  internal::UpdatePlan<Pose> plan;
  {
    ScopedTimer timer(map.Seconds().linearise);
    plan = internal::PlanUpdate(update, map, options_, judge.Width());
  }
  const auto before = internal::UpdateGate<Pose>::Look(map);
  const double minimum_before = map.MinimumCost();
  parts_->Add(update, plan, options_, report);
  judge.TakeEvicted();  // what Finish left
  judge.Admit(plan, map.MinimumCost() - minimum_before, step);
  const double minimum_after = map.MinimumCost();
  gate.Decide({update, plan, before, is_deferred}, step);
  const bool report_cost = options_.report_cost && options_.carry == Carry::kOffset;
  if (report_cost) report.actual_decrease = parts_->TimedChi2(report);
  const int new_poses = static_cast<int>(update.poses.size());
  if (options_.carry == Carry::kPoint) {
    is_deferred = internal::OptimizePoints(new_poses, step);
  } else if (!report.gate_open) {
    ScopedTimer timer(map.Seconds().solve);
    map.PlaceNewPoses(new_poses, report);
  } else {
    is_deferred = internal::OptimizeOffsets(new_poses, is_deferred, step);
  }
  judge.Review(step);
  parts_->RescueIfDiverging(plan, step);
  parts_->RestartWithoutEvicted(step);
  if (MayRestart(options_)) {
    watch.NoteStep(minimum_before, minimum_after, map, options_);
    if (report.gate_open && watch.SeemsTrapped(map) && parts_->MayTakeLong(options_)) parts_->RestartIfLower(step);
  }
  relinearization.NoteNew(report.gate_open, map, options_);
  relinearization.EndStep(map);
  if (report_cost) report.actual_decrease -= parts_->TimedChi2(report);
  report.seconds += step.Seconds();
  parts_->LogStep(update, report, was_deferred, options_);
  return report;
}

template <class Pose>
void IncrementalSolver<Pose>::Parts::Add(const GraphUpdate<Pose>& update, const internal::UpdatePlan<Pose>& plan,
                                         const IncrementalOptions& options, StepReport& report) {
  const internal::MapFrame<Pose> frame = map.Frame();
  const auto done = map.Add(update, plan, report);
  if (!done.ok) ThrowSingularUpdate(update, plan, done.failed_variable);
  for (const int slot : plan.changes.removed) {
    relinearization.Release(slot);
    judge.Release(slot);
  }
  for (const FactorId id : update.removed) judge.Unpark(id);
  relinearization.Resize(map);
  judge.Resize(map);
  const bool has_moved = !plan.moved_points.empty();
  if (has_moved) {
    relinearization.ForgetErrors(map);
    is_deferred = false;
  }
  LogFrame(frame, has_moved, options);
}

template <class Pose>
void IncrementalSolver<Pose>::Parts::LogFrame(const internal::MapFrame<Pose>& before, bool has_moved,
                                              const IncrementalOptions& options) const {
  if (has_moved) {
    Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": the map moves as a whole to where its priors put it");
  }
  const internal::MapFrame<Pose>& now = map.Frame();
  const bool is_news = now.gauge.free_shifts != before.gauge.free_shifts ||
                       now.gauge.free_turns != before.gauge.free_turns ||
                       (before.absolute.Count() == 0) != (now.absolute.Count() == 0);
  if (!is_news || now.absolute.Count() == 0 || options.anchor_information) return;
  const std::string words = internal::DescribeUndetermined(map, options);
  Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": ",
      words.empty() ? "the priors determine where the map is and how it is turned" : words.c_str());
}

// Of the system that the update would have made.
template <class Pose>
void IncrementalSolver<Pose>::Parts::ThrowSingularUpdate(const GraphUpdate<Pose>& update,
                                                         const internal::UpdatePlan<Pose>& plan,
                                                         int failed_variable) const {
  std::map<int, LinearFactor<B>> old;
  for (int slot = 0; slot < map.Slots(); ++slot) {
    if (map.Cholesky().LinearFactorAt(slot).first >= 0) old.emplace(slot, map.Cholesky().LinearFactorAt(slot));
  }
  for (const int slot : plan.changes.removed) old.erase(slot);
  for (const auto& [slot, factor] : plan.changes.replaced) old[slot] = factor;
  std::vector<LinearFactor<B>> system = plan.changes.added;
  for (const auto& [slot, factor] : old) system.push_back(factor);
  std::vector<Pose> values = plan.moved_points.empty() ? map.Points() : plan.moved_points;
  values.insert(values.end(), plan.new_values.begin(), plan.new_values.end());
  std::vector<PoseId> ids;
  for (const auto& node : map.Graph().Poses()) ids.push_back(node.id);
  for (const auto& pose : update.poses) ids.push_back(pose.id);
  SingularityReport report = ExplainSingularity(std::move(system), values, ids, failed_variable);
  report.message = "the update cannot be made: " + report.message;
  ThrowSingular(std::move(report));
}

template <class Pose>
void IncrementalSolver<Pose>::Parts::LogStep(const GraphUpdate<Pose>& update, const StepReport& report,
                                             bool was_deferred, const IncrementalOptions& options) const {
  if (!options.log) return;
  Log(options.log, LogLevel::kDebug, "step ", map.Updates(), ": ", update.poses.size(), " poses, ",
      update.factors.size(), " factors, ", update.removed.size(), " removed; factor ", NameForLog(report.path), " (",
      report.variables_refactored, " of ", map.Cholesky().Variables(), " poses refactored), gain ", report.gain_nats,
      " nats; gate ", report.gate_open ? "open" : "closed", " at ", report.gate_value, " (threshold ",
      options.gate_threshold, "); ", report.iterations, " iterations, ", report.variables_relinearised,
      " relinearised, ", report.variables_moved, " moved");
  if (is_deferred && !was_deferred) {
    Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": over its budget, ", report.deferred_relinearisations,
        " relinearisations and ", report.deferred_fronts, " subtrees are left to later steps");
  }
  if (!is_deferred && was_deferred) {
    Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": the work left by earlier steps is done");
  }
}

// Chi2, its time taken off the step's.
template <class Pose>
double IncrementalSolver<Pose>::Parts::TimedChi2(StepReport& report) const {
  double seconds = 0, chi2 = 0;
  {
    ScopedTimer timer(seconds);
    chi2 = map.Chi2();
  }
  report.seconds -= seconds;
  return chi2;
}

template <class Pose>
void IncrementalSolver<Pose>::Parts::RestartIfLower(Step& step) {
  const IncrementalOptions& options = step.options;
  const double cost = map.Chi2();
  // Still on its way: the next steps bring most such maps to rest in as good a minimum by themselves.
  if (cost > internal::kSettled * map.MinimumCost()) return;
  watch.NoteTried(map);
  const double explained = watch.Explained();
  BatchOptions batch;
  batch.threads = options.threads;
  const std::optional<BatchResult<Pose>> lower = watch.LowerMinimum(cost, true, map.Graph(), map, batch);
  if (!lower || !TakeRestart(*lower, step)) {
    Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": chi2 ", cost, ", the innovations explain ", explained,
        "; a restart from the chordal relaxation finds nothing lower");
    return;
  }
  Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": a wrong minimum, chi2 ", cost,
      ", the innovations explain ", explained, "; restarted from the chordal relaxation, chi2 ", lower->chi2);
}

template <class Pose>
bool IncrementalSolver<Pose>::Parts::TakeRestart(const BatchResult<Pose>& lower, Step& step) {
  if (!MoveTo(lower.T_world_body, step.options)) return false;
  watch.NoteRestart(map);
  step.report.restarted = true;
  step.report.variables_moved = step.report.variables_relinearised = map.Cholesky().Variables();
  return true;
}

// kGnc: where a group of wrong loops was believed and is found out, the map may be bent so far that it comes to rest in
// a wrong minimum, and from there true loops look wrong. A map that is lost is worse than a step that takes too long.
template <class Pose>
void IncrementalSolver<Pose>::Parts::RestartWithoutEvicted(Step& step) {
  const IncrementalOptions& options = step.options;
  const bool may = options.robust.kernel == RobustKernel::kGnc && options.carry == Carry::kOffset && options.restart;
  if (judge.TakeEvicted() < kGroup || !may) return;
  BatchOptions batch;
  batch.threads = options.threads;
  const double cost = map.MinimumCost();
  const PoseGraph<Pose> believed = WithWeights(map.Graph(), judge.WeightsIn(map));
  const std::optional<BatchResult<Pose>> lower = watch.LowerMinimum(cost, true, believed, map, batch);
  if (!lower || lower->chi2 * kTrapped > cost || !TakeRestart(*lower, step)) return;
  Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": a wrong minimum after loops went, chi2 ", cost,
      "; restarted from the chordal relaxation of what is in, chi2 ", lower->chi2);
}

// kGnc: a loop that went again while the map was on its way to it can leave the map where full steps lead nowhere. Then
// it comes to rest by damped ones, from where it is and from composed odometry, with the loops that are in. A map that
// is lost is worse than a step that takes too long, so this is not left out under a budget.
template <class Pose>
void IncrementalSolver<Pose>::Parts::RescueIfDiverging(const internal::UpdatePlan<Pose>& plan, Step& step) {
  const IncrementalOptions& options = step.options;
  const bool may = options.robust.kernel == RobustKernel::kGnc && options.carry == Carry::kOffset &&
                   step.report.gate_open && plan.BringsLoopsOnly() && plan.Loops() == 0;
  if (!may || !(step.report.gate_value > kDiverging * judge.Width() * judge.Width())) return;
  if (map.Updates() % kRescueEvery != 0 && !MayTakeLong(options)) return;
  BatchOptions batch;
  batch.threads = options.threads;
  const PoseGraph<Pose> graph = WithWeights(map.Graph(), judge.WeightsIn(map));
  BatchResult<Pose> best;
  best.chi2 = std::numeric_limits<double>::infinity();
  std::vector<std::vector<Pose>> starts = {map.Estimates()};
  if (ConnectedComponents(graph).size() == 1) starts.push_back(ComputeInitialValues(graph, InitialValues::kCompose));
  for (const auto& start : starts) {
    BatchResult<Pose> result = SolveBatch(graph, start, batch);
    const bool is_lower = result.chi2 < (1 - kSameMinimum) * best.chi2;
    if (result.termination != Termination::kNotPositiveDefinite && is_lower) best = std::move(result);
  }
  if (best.T_world_body.empty() || !MoveTo(best.T_world_body, options)) return;
  Log(options.log, LogLevel::kInfo, "step ", map.Updates(), ": the map did not come to rest, now at chi2 ", best.chi2);
}

// All linearisation points. False, and nothing changes, if the Cholesky factor does not take them.
template <class Pose>
bool IncrementalSolver<Pose>::Parts::MoveTo(const std::vector<Pose>& T_world_body, const IncrementalOptions& options) {
  StepReport report;
  Step step{options, map, relinearization, report};
  if (!internal::MoveMap(T_world_body, step)) return false;
  is_deferred = false;
  return true;
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::Finish(const BatchOptions& options) {
  auto& [map, relinearization, gate, judge, watch, is_deferred] = *parts_;
  if (MayRestart(options_) && !Graph().Poses().empty()) {
    BatchOptions quiet;
    quiet.threads = options.threads;
    const double cost = Chi2();
    if (const auto lower = watch.LowerMinimum(cost, watch.IsSuspected(map), map.Graph(), map, quiet)) {
      BatchResult<Pose> result = FinishFrom(lower->T_world_body, options);
      if (result.termination != Termination::kNotPositiveDefinite) {
        Log(options_.log, LogLevel::kInfo, "finish: a wrong minimum, chi2 ", cost,
            "; restarted from the chordal relaxation, chi2 ", result.chi2);
        watch.NoteRestart(map);
      }
      return result;
    }
  }
  if (options_.robust.kernel == RobustKernel::kGnc && options_.carry == Carry::kOffset) {
    StepReport report;
    typename Parts::Step step{options_, map, relinearization, report};
    judge.DropRefused(step);
    BatchOptions near = options;
    near.max_iterations = std::min(options.max_iterations, kIterationsOfRound);
    double lowest = FinishFrom(Estimates(), near).robust_cost;
    int vain = 0;  // rounds in a row after which everything came back
    for (int round = 0; round < kMostFinishRounds && vain < kMostVainRounds; ++round) {
      if (!judge.ReviewAllOdometry(step) && !judge.JudgeParkedGroups(step)) break;
      parts_->RestartWithoutEvicted(step);
      const double cost = FinishFrom(Estimates(), near).robust_cost;
      vain = cost < lowest * (1 - kSameCost) ? 0 : vain + 1;
      lowest = std::min(lowest, cost);
    }
    BatchResult<Pose> result = FinishFrom(Estimates(), options);
    if (!options.graduate || result.termination == Termination::kNotPositiveDefinite) return result;
    std::optional<BatchResult<Pose>> cheaper = parts_->SelectAnew(result, options, options_);
    if (cheaper) {
      judge.LimitWidth(cheaper->robust_width);
      result = parts_->TakeOptimum(std::move(*cheaper), options_);
    }
    std::optional<BatchResult<Pose>> freed = parts_->LetGoHanging(result, options, options_);
    return freed ? parts_->TakeOptimum(std::move(*freed), options_) : std::move(result);
  }
  return FinishFrom(Estimates(), options);
}

// The optimum of loops that are told apart anew, if many are out and it is a better one.
template <class Pose>
std::optional<BatchResult<Pose>> IncrementalSolver<Pose>::Parts::SelectAnew(const BatchResult<Pose>& finished,
                                                                            const BatchOptions& given,
                                                                            const IncrementalOptions& options) const {
  const PoseGraph<Pose>& graph = map.Graph();
  if (!internal::IsConnected(graph)) return std::nullopt;
  const std::vector<FactorId> loops = LoopFactors(graph);
  const auto out = std::count(finished.weights.begin(), finished.weights.end(), 0.0);
  if (static_cast<double>(out) <= kManyOut * static_cast<double>(loops.size())) return std::nullopt;
  BatchOptions anew = given;
  anew.robust = options.robust;
  bool is_stopped = false;
  const auto selected = internal::SelectBorneOut(graph, anew, is_stopped);
  if (!selected || is_stopped) return std::nullopt;
  // Costs of different widths are not comparable.
  const double width = std::min(selected->width, finished.robust_width);
  const auto cost = [&](const std::vector<Pose>& T_world_body) {
    return internal::TruncatedCost(graph, T_world_body, selected->robust_factors, width);
  };
  const double before = cost(finished.T_world_body), after = cost(selected->T_world_body);
  if (!(after < before * (1 - kSameMinimum))) return std::nullopt;
  Log(options.log, LogLevel::kInfo, "finish: loops told apart anew, cost ", before, " to ", after);
  anew.graduate = false;
  anew.robust.width = width;
  anew.robust_factors = selected->robust_factors;
  BatchResult<Pose> result = SolveBatch(graph, selected->T_world_body, anew);
  if (result.termination == Termination::kNotPositiveDefinite) return std::nullopt;
  return result;
}

// The optimum without loops that hold a part of the map where odometry would not have it, if that is a better one.
template <class Pose>
std::optional<BatchResult<Pose>> IncrementalSolver<Pose>::Parts::LetGoHanging(const BatchResult<Pose>& finished,
                                                                              const BatchOptions& given,
                                                                              const IncrementalOptions& options) const {
  const PoseGraph<Pose>& graph = map.Graph();
  if (!internal::IsConnected(graph)) return std::nullopt;
  BatchOptions judged = given;
  judged.robust = options.robust;
  if (!judged.log) judged.log = options.log;
  const std::vector<FactorId> loops = LoopFactors(graph), slips = SlippedOdometry(graph, finished.weights);
  judged.robust_factors.emplace();
  std::set_union(loops.begin(), loops.end(), slips.begin(), slips.end(), std::back_inserter(*judged.robust_factors));
  return internal::WithoutHangingLoops(graph, finished, judged);
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::FinishFrom(const std::vector<Pose>& T_world_body,
                                                      const BatchOptions& given) {
  BatchOptions options = given;
  if (!options.log) options.log = options_.log;
  const bool anew = options_.carry == Carry::kPoint;
  return parts_->TakeOptimum(parts_->judge.SolveBatch(parts_->map, T_world_body, options, anew), options_);
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::Parts::TakeOptimum(BatchResult<Pose> result,
                                                              const IncrementalOptions& options) {
  if (result.termination == Termination::kNotPositiveDefinite) return result;
  StepReport report;
  Step step{options, map, relinearization, report};
  judge.TakeWeights(result.weights, step);
  // The Cholesky factor of this solver moves to the optimum too: every linearisation point changes.
  const double before = map.MinimumCost();
  if (!MoveTo(result.T_world_body, options)) throw NumericalError("the system is singular at the optimum");
  watch.NoteCorrection(std::abs(map.MinimumCost() - before));
  return result;
}

template <class Pose>
int IncrementalSolver<Pose>::Restarts() const {
  return static_cast<int>(parts_->watch.Restarts());
}
template <class Pose>
void IncrementalSolver<Pose>::LimitRobustWidth(double width) {
  parts_->judge.LimitWidth(width);
}
template <class Pose>
void IncrementalSolver<Pose>::CountOnFrom(const IncrementalSolver& earlier) {
  parts_->watch.CountRestarts(earlier.parts_->watch.Restarts());
  parts_->judge.LearnFrom(earlier.parts_->judge);
  PhaseSeconds& seconds = parts_->map.Seconds();
  const PhaseSeconds& before = earlier.Seconds();
  seconds.order += before.order;
  seconds.linearise += before.linearise;
  seconds.factor += before.factor;
  seconds.solve += before.solve;
}
template <class Pose>
const PoseGraph<Pose>& IncrementalSolver<Pose>::Graph() const {
  return parts_->map.Graph();
}
template <class Pose>
Pose IncrementalSolver<Pose>::EstimateAt(int index) const {
  return parts_->map.EstimateAt(index);
}
template <class Pose>
std::vector<Pose> IncrementalSolver<Pose>::Estimates() const {
  return parts_->map.Estimates();
}
template <class Pose>
double IncrementalSolver<Pose>::Chi2() const {
  return parts_->map.Chi2();
}
template <class Pose>
double IncrementalSolver<Pose>::RobustChi2() const {
  return parts_->judge.RobustChi2(parts_->map);
}
template <class Pose>
double IncrementalSolver<Pose>::WeightOf(FactorId id) const {
  return parts_->judge.WeightOf(id, parts_->map);
}
template <class Pose>
const BlockCholesky<Pose::kDof>& IncrementalSolver<Pose>::Cholesky() const {
  return parts_->map.Cholesky();
}
template <class Pose>
const std::vector<Pose>& IncrementalSolver<Pose>::LinearizationPoints() const {
  return parts_->map.Points();
}
template <class Pose>
const PhaseSeconds& IncrementalSolver<Pose>::Seconds() const {
  return parts_->map.Seconds();
}
template <class Pose>
const Gauge<Pose>& IncrementalSolver<Pose>::CurrentGauge() const {
  return parts_->map.Frame().gauge;
}
template <class Pose>
std::string IncrementalSolver<Pose>::DescribeUndetermined() const {
  return internal::DescribeUndetermined(parts_->map, options_);
}
template <class Pose>
void IncrementalSolver<Pose>::SetLog(LogSink log) {
  options_.log = std::move(log);
}

template <class Pose>
template <class Archive>
void IncrementalSolver<Pose>::Serialize(Archive& archive) {
  auto& [options, parts] = *this;
  auto& [map, relinearization, gate, judge, watch, is_deferred] = *parts;
  archive(options, map, relinearization, gate, judge, watch, is_deferred);
  relinearization.SerializeTimes(archive);
  archive(map.Seconds());
  if constexpr (Archive::kReads) {
    for (const std::string& defect :
         {relinearization.FindStateDefect(map), gate.FindStateDefect(), judge.FindStateDefect(map)}) {
      if (!defect.empty()) archive.Fail(defect);
    }
    relinearization.NoteLoaded(map);
    map.LimitReordering(kFlopsPerSecond * options.budget_seconds);
    if ((options.robust.kernel != RobustKernel::kNone) != judge.IsActive()) archive.Fail("loops that nobody judges");
  }
}

template <class Pose>
void IncrementalSolver<Pose>::Save(const std::string& path) const {
  SaveState(path, StateKind<Pose>("incremental solver"), *this);
}

template <class Pose>
IncrementalSolver<Pose> IncrementalSolver<Pose>::Load(const std::string& path, LogSink log) {
  IncrementalSolver solver = LoadState<IncrementalSolver>(path, StateKind<Pose>("incremental solver"));
  solver.SetLog(std::move(log));
  Log(solver.options_.log, LogLevel::kInfo, "restored from ", path, ": ", solver.Graph().Poses().size(), " poses, ",
      solver.Graph().Factors().size(), " factors after ", solver.parts_->map.Updates(), " steps");
  return solver;
}

#define TERSE_INSTANTIATE(Pose)                                   \
  template class IncrementalSolver<Pose>;                         \
  template void IncrementalSolver<Pose>::Serialize(StateWriter&); \
  template void IncrementalSolver<Pose>::Serialize(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
