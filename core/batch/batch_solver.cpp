#include "terse/core/batch_solver.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>
#include <stdexcept>

#include "batch/batch_problem.h"
#include "cholesky/elimination.h"
#include "incremental/loop_selection.h"
#include "support/stopwatch.h"
#include "terse/core/atomic_file.h"
#include "terse/core/error.h"
#include "terse/core/hanging_loops.h"
#include "terse/core/log_message.h"
#include "terse/core/number_text.h"
#include "terse/core/start_values.h"

namespace terse {
namespace {

using internal::Damping;
using internal::Log;
using internal::Problem;
using internal::ScopedTimer;
using internal::Step;
using std::size_t;

double LargestEntry(const std::vector<double>& v) {
  double largest = 0;
  for (const double x : v) largest = std::max(largest, std::abs(x));
  return largest;
}

template <class Pose>
std::vector<PoseId> IdsOf(const PoseGraph<Pose>& graph) {
  std::vector<PoseId> ids;
  for (const auto& node : graph.Poses()) ids.push_back(node.id);
  return ids;
}

// One solver run; the loop is spread over small members.
template <class Pose>
class Run {
 public:
  static constexpr int B = Pose::kDof;

  Run(const PoseGraph<Pose>& graph, const std::vector<Pose>& initial, const BatchOptions& options)
      : graph_(graph),
        problem_(graph, options.threads, &options),
        options_(options),
        tolerance_(options.relative_tolerance) {
    if (initial.size() != graph.Poses().size()) throw std::invalid_argument("one initial value per pose is needed");
    result_.T_world_body = initial;
    PrepareCholesky();
    internal::RequireOrder(options.order, initial.size());
    if (!problem_.IsRobust()) result_.cholesky.SetOrder(options.order);
  }

  BatchResult<Pose> Execute() && {
    // Loops that good initial values contradict would make the first factor dense for nothing.
    if (options_.robust.kernel == RobustKernel::kGnc && !options_.graduate) {
      problem_.HoldWeights(result_.T_world_body, std::numeric_limits<double>::infinity());
    }
    const bool is_built = BuildFactor();
    Log(options_.log, LogLevel::kInfo, "batch: ", graph_.Poses().size(), " poses, ", graph_.Factors().size(),
        " factors, chi2 ", result_.chi2);
    if (is_built) {
      if (options_.robust.kernel == RobustKernel::kGnc) Graduate();
      if (!singular_) Iterate();
    }
    problem_.Cost(result_.T_world_body, result_.chi2);  // as everyone else sums it, to the last bit
    result_.robust_cost = problem_.IsRobust() ? problem_.RobustCost(result_.T_world_body) : result_.chi2;
    if (problem_.IsRobust()) result_.robust_width = problem_.Width();
    if (problem_.IsRobust()) result_.weights = problem_.WeightsAt(result_.T_world_body);
    result_.cholesky.SetProgress({});
    Log(options_.log, result_.Converged() ? LogLevel::kInfo : LogLevel::kWarning, "batch: ", Name(result_.termination),
        " after ", result_.iterations, " iterations, chi2 ", result_.chi2, ": ", result_.message);
    return std::move(result_);
  }

 private:
  void Finish(Termination termination, const std::string& message) {
    result_.termination = termination;
    result_.message = message;
    done_ = true;
  }

  // An empty factor.
  void PrepareCholesky() {
    result_.cholesky = BlockCholesky<B>();
    result_.cholesky.SetThreads(options_.threads);
    result_.cholesky.DropUpdateMatrices(options_.most_factor_bytes);
    result_.cholesky.SetProgress(options_.factor_progress);
  }

  bool BuildFactor() {
    typename BlockCholesky<B>::Changes everything;
    {
      ScopedTimer timer(result_.seconds.linearise);
      everything = problem_.Everything(result_.T_world_body, cost_, result_.chi2);
    }
    if (!std::isfinite(cost_)) {
      Finish(Termination::kDiverged, "chi2 is not finite at the initial values");
      return false;
    }
    double seconds = 0;
    typename BlockCholesky<B>::UpdateReport report;
    {
      ScopedTimer timer(seconds);
      report = result_.cholesky.Update(everything);
    }
    result_.seconds.order += report.seconds_order;
    result_.seconds.factor += seconds - report.seconds_order;
    if (!report.ok) FinishSingular(std::move(everything.added), report.failed_variable);
    if (report.ok) ready_ = Ready::kFactored;
    return report.ok;
  }

  void FinishSingular(std::vector<LinearFactor<B>> system, int failed_variable) {
    auto singular = ExplainSingularity(std::move(system), result_.T_world_body, IdsOf(graph_), failed_variable);
    Finish(Termination::kNotPositiveDefinite, singular.message);
    result_.free_motions = std::move(singular.motions);
    result_.cholesky = BlockCholesky<B>();
    singular_ = true;
  }

  // At most so many steps.
  void Descend(int steps) {
    for (int k = 0; !done_; ++k) {
      if (k >= steps) {
        Finish(Termination::kMaxIterations, "stopped after " + std::to_string(result_.iterations) + " iterations");
        break;
      }
      TakeStep();
      if (!done_ && options_.progress && !options_.progress(result_.iterations, result_.chi2)) {
        Finish(Termination::kStopped, "stopped by the caller");
      }
    }
    if (best_) Accept(std::move(*best_));
    best_.reset();
  }

  // Weights from here on, for a descent of their own.
  int Reweigh(double mu) {
    const int changed = problem_.HoldWeights(result_.T_world_body, mu);
    Log(options_.log, LogLevel::kDebug, "batch: robust stage mu ", mu, ": ", changed, " weights changed");
    ready_ = Ready::kNothing;
    climbing_ = 0;
    damping_control_ = Damping();
    if (problem_.IsOutdated()) {
      Log(options_.log, LogLevel::kDebug, "batch: the factor is ordered anew for the loops that have weight");
      PrepareCholesky();
      BuildFactor();
    } else {
      cost_ = problem_.LinearizeTerms(result_.T_world_body, next_, result_.chi2);
      ready_ = Ready::kNext;
    }
    return changed;
  }

  // Graduated non-convexity (Yang et al., RA-L 2020, Algorithm 1), a few steps per mu; then weights of zero and one in
  // turn with the poses until they agree, which can only lower the cost.
  void Graduate() {
    tolerance_ = kStageTolerance;
    double mu = GncStart(options_.graduate ? problem_.LargestRobustChi2(result_.T_world_body) : 0, problem_.Width());
    for (; std::isfinite(mu) && MayGoOn(); mu *= options_.robust.gnc_step) {
      Reweigh(mu);
      if (problem_.HoldsOnlyZerosAndOnes() || !MayGoOn()) break;
      Descend(kStageSteps);
      done_ = !MayGoOn();
    }
    tolerance_ = options_.relative_tolerance;
    for (int round = 0; round < kMostRounds && MayGoOn(); ++round) {
      if (Reweigh(std::numeric_limits<double>::infinity()) == 0 && round > 0) break;
      if (!MayGoOn()) break;
      done_ = false;
      Descend(options_.max_iterations);
      if (!result_.Converged()) break;  // crawling
    }
    done_ = true;
  }
  bool MayGoOn() const { return !singular_ && result_.termination != Termination::kStopped; }

  // What the priors determine where the poses came to lie is theirs to say: the anchor holds it no more.
  void UpdateGauge() {
    const Gauge<Pose> found = FindGauge(graph_, result_.T_world_body);
    if (found.root == problem_.CurrentGauge().root) return;
    const Gauge<Pose> before = problem_.CurrentGauge();
    problem_.SetGauge(found);
    ready_ = Ready::kNothing;
    const bool lets_go = found.free_shifts < before.free_shifts || found.free_turns < before.free_turns;
    if (!lets_go || !result_.Converged() || result_.iterations >= options_.max_iterations) return;
    Log(options_.log, LogLevel::kInfo, "batch: the priors determine more of the frame than at the start, going on");
    done_ = false;
    Descend(options_.max_iterations - result_.iterations);
  }

  void Iterate() {
    Descend(options_.max_iterations);
    UpdateGauge();
    // The factor that is handed out is the undamped one at the final values.
    bool is_factored = ready_ == Ready::kFactored || RefactorAt(0);
    result_.gradient_norm = LargestEntry(result_.cholesky.System().Gradient());
    if (!is_factored) {
      // Another order may round better; or it says what is free.
      Log(options_.log, LogLevel::kInfo, "batch: not positive definite at the optimum, the factor is ordered anew");
      PrepareCholesky();
      is_factored = BuildFactor();
    }
    if (!is_factored) return;
    result_.cholesky.Solve();
    result_.log_determinant = result_.cholesky.LogDeterminant();
  }

  bool RefactorAt(double lambda) {
    if (ready_ < Ready::kLinearised) {
      ScopedTimer timer(result_.seconds.linearise);
      double chi2 = 0;
      if (ready_ != Ready::kNext) problem_.LinearizeTerms(result_.T_world_body, next_, chi2);
      result_.cholesky.ExchangeLinearFactors(next_);
    }
    ready_ = Ready::kLinearised;
    ScopedTimer timer(result_.seconds.factor);
    damping_.clear();
    if (lambda > 0) {
      damping_ = result_.cholesky.System().Diagonal();
      for (double& x : damping_) x = lambda * std::max(x, 1e-12);
    }
    if (!result_.cholesky.Refactor(damping_)) return false;
    if (lambda == 0) ready_ = Ready::kFactored;
    return true;
  }

  void TakeStep() {
    ++result_.iterations;
    const double lambda = damping_control_.Lambda();
    if ((ready_ != Ready::kFactored || lambda > 0) && !RefactorAt(lambda)) {
      return Reject("the system is not positive definite");
    }
    std::vector<double> d;
    {
      ScopedTimer timer(result_.seconds.solve);
      result_.cholesky.Solve();
      d = result_.cholesky.Solution();
    }
    double predicted = result_.cholesky.NewtonDecrement();
    for (size_t i = 0; i < damping_.size(); ++i) predicted += damping_[i] * d[i] * d[i];
    State trial{Step(result_.T_world_body, d, options_.threads)};
    {
      // A trial is nearly always where the next step sets off.
      ScopedTimer timer(result_.seconds.linearise);
      trial.cost = problem_.LinearizeTerms(trial.values, next_, trial.chi2);
      trial.is_next = true;
    }
    const double decrease = cost_ - trial.cost;
    // chi2 has no unit: below the constant it is rounding.
    const double tolerance = tolerance_ * cost_ + 1e-16;
    const bool small = predicted <= tolerance;
    Log(options_.log, LogLevel::kDebug, "batch: iteration ", result_.iterations, ": cost ", cost_, " to ", trial.cost,
        ", predicted ", cost_ - predicted, ", damping ", lambda);
    // Near the optimum the cost is rounding, and the step is better than it.
    const bool is_last = small && lambda == 0 && decrease >= -tolerance;
    if (std::isfinite(trial.cost) && (decrease >= 0 || is_last)) {
      Accept(std::move(trial));
      damping_control_.Accept(predicted > kRounding * cost_ ? decrease / predicted : 1);
      if (best_ && cost_ < best_->cost) {
        best_.reset();
        climbing_ = 0;
      }
    } else if (!small && MayClimb(trial.cost, lambda)) {
      if (!best_) best_ = State{result_.T_world_body, result_.chi2, cost_};
      Accept(std::move(trial));
    } else if (!small || lambda > 0) {
      return Reject("chi2 would rise from " + Shortest(cost_) + " to " + Shortest(trial.cost));
    }
    if (best_ && ++climbing_ > kClimb) return Retreat();
    if (!best_ && lambda == 0 && (small || (decrease >= 0 && decrease <= tolerance))) {
      Finish(Termination::kConverged, "chi2 changes by less than " + Shortest(tolerance_) + " of itself");
    }
  }

  struct State {
    std::vector<Pose> values;
    double chi2 = 0, cost = 0;
    bool is_next = false;  // next_ is its linearisation
  };

  void Accept(State state) {
    result_.T_world_body = std::move(state.values);
    result_.chi2 = state.chi2;
    cost_ = state.cost;
    ready_ = state.is_next ? Ready::kNext : Ready::kNothing;
  }

  // Stiff odometry makes curved valleys, which a solver that only descends crawls along. Full steps may therefore
  // climb for a few iterations; if they do not come out below where they set off, damping takes over from there.
  bool MayClimb(double cost, double lambda) const {
    if (options_.method == Method::kGaussNewton || lambda > 0 || !std::isfinite(cost)) return false;
    return cost < 100 * (best_ ? best_->cost : cost_);
  }

  void Retreat() {
    Log(options_.log, LogLevel::kInfo, "batch: iteration ", result_.iterations,
        ": full steps do not come out below cost ", best_->cost, ", damped steps from there");
    Accept(std::move(*best_));
    best_.reset();
    climbing_ = 0;
    damping_control_.Reject();
  }

  void Reject(const std::string& why) {
    if (best_) return Retreat();
    if (options_.method == Method::kGaussNewton) return Finish(Termination::kDiverged, why);
    damping_control_.Reject();
    Log(options_.log, LogLevel::kDebug, "batch: iteration ", result_.iterations, ": rejected, ", why, ", damping ",
        damping_control_.Lambda());
    if (damping_control_.Lambda() > 1e16) Finish(Termination::kStalled, why + ", and no damping helps");
  }

  static constexpr int kClimb = 4;
  // Of the graduation, and how often the loops are told apart at most.
  static constexpr int kStageSteps = 2, kMostRounds = 20;
  static constexpr double kStageTolerance = 1e-2;
  static constexpr double kRounding = 1e-12;  // of the cost: what a difference of two costs does not tell

  const PoseGraph<Pose>& graph_;
  Problem<Pose> problem_;
  const BatchOptions& options_;
  BatchResult<Pose> result_;
  Damping damping_control_;
  std::vector<double> damping_;
  double cost_ = 0, tolerance_;
  std::optional<State> best_;  // where full steps began to climb
  int climbing_ = 0;
  bool done_ = false, singular_ = false;
  // What there is for the current values: the linearisation in next_, or in the factor, or that factored undamped.
  enum class Ready { kNothing, kNext, kLinearised, kFactored };
  Ready ready_ = Ready::kNothing;
  std::vector<LinearFactor<B>> next_;
};

}  // namespace

// Loops of a graph that is graduated as a whole besides.
constexpr size_t kMostGraduated = 500;

const char* Name(Termination termination) {
  switch (termination) {
    case Termination::kConverged: return "converged";
    case Termination::kMaxIterations: return "max_iterations";
    case Termination::kStalled: return "stalled";
    case Termination::kDiverged: return "diverged";
    case Termination::kNotPositiveDefinite: return "not_positive_definite";
    case Termination::kStopped: return "stopped";
  }
  return "unknown";
}

template <class Pose>
BatchResult<Pose> SolveBatch(const PoseGraph<Pose>& graph, const std::vector<Pose>& initial,
                             const BatchOptions& options) {
  const bool selects = options.robust.kernel == RobustKernel::kGnc && options.graduate && !options.robust_factors;
  if (!selects || initial.size() != graph.Poses().size()) return Run<Pose>(graph, initial, options).Execute();
  bool is_stopped = false;
  std::optional<internal::LoopSelection<Pose>> selected = internal::SelectBorneOut(graph, options, is_stopped);
  if (!selected && !is_stopped) selected = internal::SelectByReplay(graph, options, is_stopped);
  BatchOptions from_there = options;
  from_there.graduate = !selected;
  if (is_stopped) from_there.progress = [](int, double) { return false; };
  if (selected) {
    from_there.robust_factors = selected->robust_factors;
    from_there.robust.width = selected->width;
  }
  BatchResult<Pose> result = Run<Pose>(graph, selected ? selected->T_world_body : initial, from_there).Execute();
  // With all loops at once the factor fills up: only where that costs little.
  if (selected && !is_stopped && LoopFactors(graph).size() <= kMostGraduated) {
    BatchOptions anew = options;
    anew.robust.width = selected->width;  // of one width, for costs of different ones are not comparable
    BatchResult<Pose> graduated = Run<Pose>(graph, initial, anew).Execute();
    if (graduated.robust_cost < result.robust_cost * (1 - 1e-9)) result = std::move(graduated);
  }
  if (is_stopped) return result;
  if (!selected) from_there.robust_factors = LoopFactors(graph);
  std::optional<BatchResult<Pose>> without = internal::WithoutHangingLoops(graph, result, from_there);
  return without ? std::move(*without) : std::move(result);
}

template <class Pose>
BatchResult<Pose> SolveBatch(const PoseGraph<Pose>& graph, const BatchOptions& options) {
  StartChoice<Pose> start = StartFor(graph, options);
  BatchOptions in_order = options;
  in_order.order = std::move(start.order);
  return SolveBatch(graph, start.T_world_body, in_order);
}

template <class Pose>
BlockCholesky<Pose::kDof> CholeskyAt(const PoseGraph<Pose>& graph, const std::vector<Pose>& T_world_body) {
  if (T_world_body.size() != graph.Poses().size()) throw std::invalid_argument("one value per pose is needed");
  BlockCholesky<Pose::kDof> cholesky;
  auto everything = Problem<Pose>(graph, 1).Everything(T_world_body);
  const auto report = cholesky.Update(everything);
  if (!report.ok) {
    ThrowSingular(ExplainSingularity(std::move(everything.added), T_world_body, IdsOf(graph), report.failed_variable));
  }
  cholesky.Solve();
  return cholesky;
}

#define TERSE_INSTANTIATE(Pose)                                                                                       \
  template BatchResult<Pose> SolveBatch<Pose>(const PoseGraph<Pose>&, const BatchOptions&);                           \
  template BatchResult<Pose> SolveBatch<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&, const BatchOptions&); \
  template BlockCholesky<Pose::kDof> CholeskyAt<Pose>(const PoseGraph<Pose>&, const std::vector<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
