// Wrong minima, and the way out of them.
//
// Were the residuals linear, each update would raise the least chi2 by its innovation, r' (Omega^-1 + J Sigma J')^-1 r,
// and nothing else would change it. So chi2 would be the sum of the innovations, whatever the scale of the information.
// What relinearisation does to the linearised minimum measures how far the residuals are from that. A map that went
// into a wrong minimum has been through large corrections, and its cost lies far above the innovations or was corrected
// by many times itself. Then, at first seldom, a chordal relaxation of the graph as it is shows whether there is
// anything lower.

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "incremental/incremental_plan.h"
#include "terse/core/error.h"
#include "terse/core/initial_values.h"
#include "terse/core/log_message.h"
#include "terse/core/residual.h"

namespace terse {
namespace {

using internal::Log;
using std::size_t;

// Another attempt is worth it when the graph or the cost has grown by this factor since the last.
constexpr double kGrowth = 2;
// The map is suspected above so many times the innovations, or if corrections came to so many times its cost. In the
// public graphs the cost never exceeds 1.02 times the innovations, and corrections stay below 0.03 times the cost; 0.35
// to 1.4 on MIT's far loops. Random walks with 0.1 to 0.2 rad of noise per metre and few loops, a fifth of which end in
// a wrong minimum, reach 0.3 to 12.
constexpr double kBeyond = 2, kCorrected = 1;
// For Finish, which has time, so many times is enough.
constexpr double kCorrectedAtFinish = 0.05;
// A smaller cost per degree of freedom is rounding.
constexpr double kRounding = 1e-9;
constexpr long kLeastLoops = 3;
// The estimate's chi2 above the linearised minimum by more than this factor: it has not settled.
constexpr double kSettled = 1.5;
// Steps of a restart, and the cost by which it must be lower. An estimate is within 1e-3 of its own minimum.
constexpr int kMostIterations = 20;
constexpr double kLower = 0.99;

template <class Pose>
double Chi2At(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
  double chi2 = 0;
  for (const auto& node : graph.Factors()) {
    const FactorPoses ends = PosesOf(node.factor);
    chi2 += FactorChi2(node.factor, values[static_cast<size_t>(graph.IndexOf(ends.first))],
                       values[static_cast<size_t>(graph.IndexOf(ends.second))]);
  }
  return chi2;
}

}  // namespace

// The linearised minimum without the update's factors and with them, before anything was relinearised for them.
template <class Pose>
void IncrementalSolver<Pose>::WatchStep(double minimum_before, double minimum_after, StepReport& report) {
  watch_.explained += minimum_after - minimum_before;
  watch_.corrected += std::abs(LinearMinimum() - minimum_after);
  if (options_.log) {
    Log(options_.log, LogLevel::kDebug, "step ", updates_, ": chi2 ", LinearMinimum(), ", the innovations explain ",
        watch_.explained, ", corrected by ", watch_.corrected);
  }
  if (report.gate_open && options_.budget_seconds == 0 && SeemsTrapped()) RestartIfLower(report);
}

template <class Pose>
bool IncrementalSolver<Pose>::SeemsTrapped() const {
  const double cost = LinearMinimum();
  if (!(cost > kRounding * DegreesOfFreedom())) return false;
  const auto poses = static_cast<double>(graph_.Poses().size()), factors = static_cast<double>(graph_.Factors().size());
  if (factors < poses - 1 + kLeastLoops) return false;
  if (poses < kGrowth * static_cast<double>(watch_.poses_tried) && cost < kGrowth * watch_.cost_tried) return false;
  return cost > kBeyond * std::max(watch_.explained, 0.0) || watch_.corrected > kCorrected * cost;
}

template <class Pose>
void IncrementalSolver<Pose>::RestartIfLower(StepReport& report) {
  const double cost = Chi2();
  // Still on its way: the next steps bring most such maps to rest in as good a minimum by themselves.
  if (cost > kSettled * LinearMinimum()) return;
  watch_.cost_tried = LinearMinimum();
  watch_.poses_tried = static_cast<long>(graph_.Poses().size());
  BatchOptions options;
  options.threads = options_.threads;
  const std::optional<BatchResult<Pose>> lower = LowerMinimum(cost, true, options);
  if (!lower || !MoveTo(lower->T_world_body)) {
    Log(options_.log, LogLevel::kInfo, "step ", updates_, ": chi2 ", cost, ", the innovations explain ",
        watch_.explained, "; a restart from the chordal relaxation finds nothing lower");
    return;
  }
  Log(options_.log, LogLevel::kInfo, "step ", updates_, ": a wrong minimum, chi2 ", cost, ", the innovations explain ",
      watch_.explained, "; restarted from the chordal relaxation, chi2 ", lower->chi2);
  TookRestart();
  report.restarted = true;
  report.variables_moved = report.variables_relinearised = factor_.Variables();
}

template <class Pose>
void IncrementalSolver<Pose>::TookRestart() {
  ++watch_.restarts;
  watch_.cost_tried = LinearMinimum();
  watch_.corrected = 0;
  watch_.explained = std::max(watch_.explained, LinearMinimum());
}

// In the frame of the estimate where no measurement gives one. Absent if the relaxation cannot be made.
template <class Pose>
std::optional<std::vector<Pose>> IncrementalSolver<Pose>::RelaxedValues() const {
  try {
    std::vector<Pose> values = ComputeInitialValues(graph_, InitialValues::kChordal);
    if (absolute_.pose_priors == 0 && absolute_.position_priors == 0) {
      const Pose T_new_old = EstimateAt(0) * values[0].Inverse();
      for (Pose& value : values) value = T_new_old * value;
    }
    return values;
  } catch (const NumericalError&) {
    return std::nullopt;
  } catch (const std::invalid_argument&) {  // not connected: held by priors in parts
    return std::nullopt;
  }
}

// The minimum next to the relaxation, if it is clearly below `cost`. Unless `suspected` the relaxation itself must be.
template <class Pose>
std::optional<BatchResult<Pose>> IncrementalSolver<Pose>::LowerMinimum(double cost, bool suspected,
                                                                       BatchOptions options) const {
  const auto values = RelaxedValues();
  if (!values || (!suspected && !(Chi2At(graph_, *values) < cost))) return std::nullopt;
  options.max_iterations = kMostIterations;
  options.relative_tolerance = 1e-6;
  BatchResult<Pose> result = SolveBatch(graph_, *values, options);
  if (!result.Converged() && result.termination != Termination::kMaxIterations) return std::nullopt;
  if (!(result.chi2 < kLower * cost)) return std::nullopt;
  return result;
}

// All linearisation points. False, and nothing changes, if the factor does not take them.
template <class Pose>
bool IncrementalSolver<Pose>::MoveTo(const std::vector<Pose>& T_world_body) {
  Gauge<Pose> gauge = gauge_;
  if (!options_.anchor_information) gauge = FindGauge(graph_, T_world_body);
  typename BlockCholesky<B>::Changes changes;
  const auto point = [&](int v) -> const Pose& { return T_world_body[static_cast<size_t>(v)]; };
  for (int slot = 0; slot < static_cast<int>(factor_of_slot_.size()); ++slot) {
    if (factor_.FactorAt(slot).first < 0) continue;
    changes.replaced.emplace_back(slot, slot == anchor_slot_ ? Anchor(gauge) : LinearizeSlot(slot, point));
  }
  if (!factor_.Update(std::move(changes)).ok) return false;
  linearization_points_ = T_world_body;
  gauge_ = gauge;
  gauge_found_at_ = absolute_.Count();
  for (int v = 0; v < factor_.Variables(); ++v) factor_.ClearSolution(v);
  RecountCosts();
  ForgetErrors();
  deferred_ = false;
  if (options_.carry == Carry::kOffset) {
    StepReport report;
    BackSubstitute(std::nullopt, report);
  }
  return true;
}

template <class Pose>
BatchResult<Pose> IncrementalSolver<Pose>::Finish(const BatchOptions& options) {
  if (MayRestart() && !graph_.Poses().empty()) {
    BatchOptions quiet;
    quiet.threads = options.threads;
    const double cost = Chi2();
    const bool suspected = watch_.restarts > 0 || watch_.corrected > kCorrectedAtFinish * LinearMinimum();
    if (const auto lower = LowerMinimum(cost, suspected, quiet)) {
      BatchResult<Pose> result = FinishFrom(lower->T_world_body, options);
      if (result.termination != Termination::kNotPositiveDefinite) {
        Log(options_.log, LogLevel::kInfo, "finish: a wrong minimum, chi2 ", cost,
            "; restarted from the chordal relaxation, chi2 ", result.chi2);
        TookRestart();
      }
      return result;
    }
  }
  return FinishFrom(Estimates(), options);
}

#define TERSE_INSTANTIATE(Pose)                                                  \
  template void IncrementalSolver<Pose>::WatchStep(double, double, StepReport&); \
  template bool IncrementalSolver<Pose>::MoveTo(const std::vector<Pose>&);       \
  template BatchResult<Pose> IncrementalSolver<Pose>::Finish(const BatchOptions&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
