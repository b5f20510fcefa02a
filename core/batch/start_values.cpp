#include "terse/core/start_values.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "batch/batch_problem.h"
#include "cholesky/elimination.h"
#include "terse/core/elimination_order.h"
#include "terse/core/error.h"
#include "terse/core/log_message.h"

namespace terse {
namespace {

using std::size_t;

// Steps before a start is judged, and of the rivals in all.
constexpr int kRound = 3, kMostIterations = 15;
// A start has come to rest when its last step lowered the cost by less than this share of it.
constexpr double kRest = 1e-2;
// It came to rest near where it set off if that cost at most so many times as much. Starts of public graphs: 1.0 to 3
// where they are good; those that end in a wrong minimum set off 1e3 to 1e8 times as high.
constexpr double kNear = 10;
// A rival that is so many times above the best after its first round is given up; full steps climb on their way.
constexpr double kHopeless = 1e4;
// Costs that are the same; a step further would not tell them apart either.
constexpr double kSame = 1e-3;
// A step may end so many times above the best; beyond it is damped.
constexpr double kClimb = 100;

template <class Pose>
class Comparison {
 public:
  static constexpr int B = Pose::kDof;

  Comparison(const PoseGraph<Pose>& graph, const StartOptions& options)
      : graph_(graph), problem_(graph, options.threads), options_(options) {
    if (options_.order.empty()) options_.order = EliminationOrder(graph);
    internal::RequireOrder(options_.order, graph.Poses().size());
    factor_.SetOrder(options_.order);
    factor_.SetThreads(options.threads);
    factor_.DropUpdateMatrices(options.most_factor_bytes);
    factor_.SetProgress(options.factor_progress);
  }

  StartChoice<Pose> Execute() && {
    for (const auto method :
         {InitialValues::kFile, InitialValues::kCompose, InitialValues::kTree, InitialValues::kChordal}) {
      Enter(method);
    }
    std::vector<Start*> running;
    for (Start& start : starts_) {
      if (start.trial.unavailable.empty() && !start.trial.same) running.push_back(&start);
    }
    if (running.empty()) {
      const Start& composed = starts_[1];
      if (!composed.values.empty()) throw NumericalError("chi2 is not finite at any initial values");
      throw std::invalid_argument(composed.trial.unavailable);
    }
    std::stable_sort(running.begin(), running.end(),
                     [](const Start* a, const Start* b) { return a->trial.cost < b->trial.cost; });
    if (running.size() > 1) Compete(running);
    return Result();
  }

 private:
  struct Start {
    StartTrial trial;
    std::vector<Pose> values, best;  // the best is empty while it is where the values are
    double cost = 0;                 // at the values
    internal::Damping damping;
    bool rests = false;
  };

  void Enter(InitialValues method) {
    Start start;
    start.trial.method = method;
    try {
      start.values = ComputeInitialValues(graph_, method, options_);
      double chi2 = 0;
      start.cost = problem_.Cost(start.values, chi2);
      start.trial.cost_at_start = start.trial.cost = start.cost;
      if (!std::isfinite(start.cost)) start.trial.unavailable = "chi2 is not finite at the initial values";
      for (const Start& other : starts_) {
        if (other.trial.unavailable.empty() &&
            std::abs(other.cost - start.cost) <= 1e-6 * std::max(other.cost, start.cost)) {
          start.trial.same = other.trial.method;
          start.values = {};
          break;
        }
      }
    } catch (const NumericalError& e) {
      start.trial.unavailable = e.what();
    } catch (const std::invalid_argument& e) {
      start.trial.unavailable = e.what();
    }
    starts_.push_back(std::move(start));
  }

  // The starts from the lowest cost up.
  void Compete(std::vector<Start*>& running) {
    Start& first = *running.front();
    if (!Advance(first)) return;
    if (first.rests && first.trial.cost_at_start <= kNear * first.trial.cost) {
      // Others that set off as low may be as good; all that are higher would have to fall further than it did.
      const auto is_high = [&](const Start* s) {
        return s != &first && s->trial.cost_at_start > kNear * first.trial.cost;
      };
      running.erase(std::remove_if(running.begin(), running.end(), is_high), running.end());
    }
    for (int target = kRound; running.size() > 1 && target <= kMostIterations; target += kRound) {
      for (Start* start : running) {
        if (start->trial.iterations < target && !Advance(*start)) return;
      }
      const double lowest = (*std::min_element(running.begin(), running.end(), IsLower))->trial.cost;
      const auto is_done = [&](const Start* s) {
        if (s->trial.cost == lowest) return false;
        return s->rests || s->trial.cost > kHopeless * lowest || s->trial.cost <= (1 + kSame) * lowest;
      };
      running.erase(std::remove_if(running.begin(), running.end(), is_done), running.end());
    }
  }
  static bool IsLower(const Start* a, const Start* b) { return a->trial.cost < b->trial.cost; }

  // A round of steps. False if the system is singular: then there is nothing to compare, and the solver says why.
  bool Advance(Start& start) {
    for (int k = 0; k < kRound && !start.rests; ++k) {
      if (!Step(start)) return false;
    }
    return true;
  }

  bool Step(Start& start) {
    ++start.trial.iterations;
    if (!Factor(start)) {
      if (singular_) return false;
      start.damping.Reject();
      return true;
    }
    factor_.Solve();
    const std::vector<double> d = factor_.Solution();
    double predicted = factor_.NewtonDecrement();
    for (size_t i = 0; i < damping_.size(); ++i) predicted += damping_[i] * d[i] * d[i];
    std::vector<Pose> trial = internal::Step(start.values, d, options_.threads);
    double chi2 = 0;
    const double cost = problem_.Cost(trial, chi2);
    internal::Log(options_.log, LogLevel::kDebug, "start: ", Name(start.trial.method), ", iteration ",
                  start.trial.iterations, ": cost ", start.cost, " to ", cost, ", damping ", start.damping.Lambda());
    if (!(cost <= kClimb * start.trial.cost)) {
      // From where it was lowest, in shorter steps.
      if (!start.best.empty()) {
        start.values = std::exchange(start.best, {});
        start.cost = start.trial.cost;
      }
      start.damping.Reject();
      return true;
    }
    const double decrease = start.cost - cost;
    if (decrease >= 0 && start.damping.Lambda() > 0) start.damping.Accept(predicted > 0 ? decrease / predicted : 1);
    if (cost > start.trial.cost && start.best.empty()) start.best = std::move(start.values);
    if (cost <= start.trial.cost) {
      start.trial.cost = cost;
      start.best = {};
    }
    start.values = std::move(trial);
    start.cost = cost;
    start.rests = decrease >= 0 && cost <= start.trial.cost && predicted <= kRest * cost;
    return true;
  }

  // At the start's values, with its damping.
  bool Factor(const Start& start) {
    const double lambda = start.damping.Lambda();
    damping_.clear();
    if (factor_.Variables() == 0) {
      problem_.SetGauge(FindGauge(graph_, start.values));
      if (!factor_.Update(problem_.Everything(start.values)).ok) {
        singular_ = true;
        return false;
      }
      if (lambda == 0) return true;
    } else {
      problem_.SetGauge(FindGauge(graph_, start.values));  // each start lies in a frame of its own
      factor_.SetLinearFactors(problem_.LinearizeTerms(start.values));
    }
    if (lambda > 0) {
      damping_ = factor_.System().Diagonal();
      for (double& x : damping_) x = lambda * std::max(x, 1e-12);
    }
    return factor_.Refactor(damping_);
  }

  StartChoice<Pose> Result() {
    StartChoice<Pose> out;
    Start* chosen = nullptr;
    for (Start& start : starts_) {
      const StartTrial& trial = start.trial;
      if (!trial.unavailable.empty() || trial.same) continue;
      if (chosen == nullptr || trial.cost < chosen->trial.cost) chosen = &start;
    }
    out.chosen = chosen->trial.method;
    out.T_world_body = chosen->best.empty() ? std::move(chosen->values) : std::move(chosen->best);
    for (Start& start : starts_) {
      const StartTrial& t = start.trial;
      if (!t.unavailable.empty()) {
        internal::Log(options_.log, LogLevel::kInfo, "start: no ", Name(t.method), " values: ", t.unavailable);
      } else if (t.same) {
        internal::Log(options_.log, LogLevel::kInfo, "start: ", Name(t.method), " is the same as ", Name(*t.same));
      } else {
        internal::Log(options_.log, LogLevel::kInfo, "start: ", Name(t.method), " costs ", t.cost_at_start, ", ",
                      t.cost, " after ", t.iterations, " steps", &start == chosen ? "; it goes on" : "");
      }
      out.trials.push_back(t);
    }
    out.order = std::move(options_.order);
    return out;
  }

  const PoseGraph<Pose>& graph_;
  internal::Problem<Pose> problem_;
  StartOptions options_;
  BlockCholesky<B> factor_;
  std::vector<double> damping_;
  std::vector<Start> starts_;
  bool singular_ = false;
};

}  // namespace

template <class Pose>
StartChoice<Pose> ChooseStart(const PoseGraph<Pose>& graph, const StartOptions& options) {
  return Comparison<Pose>(graph, options).Execute();
}

template <class Pose>
StartChoice<Pose> StartFor(const PoseGraph<Pose>& graph, const BatchOptions& options) {
  if (options.robust.kernel == RobustKernel::kNone && !graph.Poses().empty()) {
    return ChooseStart(
        graph, {options.threads, options.log, options.factor_progress, options.order, options.most_factor_bytes});
  }
  return {InitialValues::kCompose, ComputeInitialValues(graph, InitialValues::kCompose), {}, {}};
}

#define TERSE_INSTANTIATE(Pose)                                                              \
  template StartChoice<Pose> ChooseStart<Pose>(const PoseGraph<Pose>&, const StartOptions&); \
  template StartChoice<Pose> StartFor<Pose>(const PoseGraph<Pose>&, const BatchOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
