// What the new factors are worth, and whether the map is optimised for them.

#include <algorithm>
#include <cmath>

#include "incremental/incremental_plan.h"

namespace terse {
namespace {

using std::size_t;
constexpr size_t At(int i) { return static_cast<size_t>(i); }

// |A d + r|^2 at the present d; 0 for variables beyond it.
template <int B>
double LinearCost(const LinearFactor<B>& f, const std::vector<double>& d) {
  Vector<B> e = f.residual;
  const auto add = [&](int v, const Matrix<B, B>& A) {
    if (v >= 0 && (At(v) + 1) * B <= d.size()) e += A * Eigen::Map<const Vector<B>>(d.data() + At(v) * B);
  };
  add(f.first, f.A_first);
  add(f.second, f.A_second);
  return e.squaredNorm();
}

// ln |H_nn| of the poses from `first_new` on, given all others.
template <int B>
double ConditionalLogDeterminant(const std::vector<LinearFactor<B>>& factors, int first_new, int variables) {
  if (variables == first_new + 1) {  // the usual case
    Matrix<B, B> H = Matrix<B, B>::Zero();
    for (const LinearFactor<B>& f : factors) {
      if (f.first == first_new) H += f.A_first.transpose() * f.A_first;
      if (f.second == first_new) H += f.A_second.transpose() * f.A_second;
    }
    const Eigen::LLT<Matrix<B, B>> llt(H);
    return llt.info() == Eigen::Success ? 2 * llt.matrixLLT().diagonal().array().log().sum() : 0;
  }
  typename BlockCholesky<B>::Changes changes;
  changes.new_variables = variables - first_new;
  for (LinearFactor<B> f : factors) {
    f.first -= first_new;
    if (f.second >= 0) f.second -= first_new;
    if (f.first < 0) {
      if (f.second < 0) continue;
      f.first = f.second;
      f.A_first = f.A_second;
      f.second = -1;
    } else if (f.second < 0) {
      f.second = -1;
    }
    changes.added.push_back(f);
  }
  BlockCholesky<B> conditional;
  return conditional.Update(std::move(changes)).ok ? conditional.LogDeterminant() : 0;
}

}  // namespace

template <class Pose>
typename IncrementalSolver<Pose>::GateValues IncrementalSolver<Pose>::ValuesForGate() const {
  return {factor_.LogDeterminant(), factor_.Variables()};
}

template <class Pose>
void IncrementalSolver<Pose>::ChangeCosts(const LinearFactor<B>& factor, int sign) {
  cost_at_points_ += sign * factor.residual.squaredNorm();
  linear_cost_ += sign * LinearCost(factor, factor_.Solution());
}

template <class Pose>
void IncrementalSolver<Pose>::RecountCosts() {
  cost_at_points_ = linear_cost_ = 0;
  for (int slot = 0; slot < static_cast<int>(factor_of_slot_.size()); ++slot) {
    if (factor_.FactorAt(slot).first >= 0) ChangeCosts(factor_.FactorAt(slot), 1);
  }
}

template <class Pose>
double IncrementalSolver<Pose>::RemainingDecrease() const {
  return std::max(0.0, linear_cost_ - LinearMinimum());
}

template <class Pose>
double IncrementalSolver<Pose>::DegreesOfFreedom() const {
  return std::max(1.0, static_cast<double>(measured_scalars_ - B * factor_.Variables()));
}

template <class Pose>
bool IncrementalSolver<Pose>::ClosesLoop(const GraphUpdate<Pose>& update) const {
  const int old = factor_.Variables() - static_cast<int>(update.poses.size());
  std::vector<char> is_joined(update.poses.size(), 0);  // the factor that brings a pose in closes nothing
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    const auto [low, high] = std::minmax({graph_.IndexOf(f->from), graph_.IndexOf(f->to)});
    if (high >= old && std::exchange(is_joined[At(high - old)], 1) == 0) continue;
    if (high - low > options_.gate_threshold) return true;
  }
  return false;
}

template <class Pose>
void IncrementalSolver<Pose>::DecideGate(const GraphUpdate<Pose>& update, const Plan& plan, const GateValues& before,
                                         StepReport& report) {
  const double log_det = factor_.LogDeterminant();
  if (before.variables > 0) {
    const double conditional =
        update.poses.empty() ? 0 : ConditionalLogDeterminant(plan.changes.added, before.variables, factor_.Variables());
    report.gain_nats = 0.5 * (log_det - before.log_determinant - conditional);
  }
  const double remaining = RemainingDecrease();
  report.predicted_decrease = remaining;
  switch (options_.gate) {
    case Gate::kNewtonDecrement: {
      double unit = 1;
      if (options_.decrease_scale == DecreaseScale::kChi2) unit = CostUnit();
      if (options_.decrease_scale == DecreaseScale::kDof) unit = DegreesOfFreedom();
      report.gate_value = remaining / unit;
      break;
    }
    case Gate::kMutualInformation: report.gate_value = report.gain_nats; break;
    case Gate::kLogDeterminant: {
      // eta_{t-1} as it was before the iterations of the previous step.
      if (eta_variables_ == 0) break;
      const double ratio = static_cast<double>(factor_.Variables()) / static_cast<double>(eta_variables_);
      report.gate_value = 0.5 * log_det - ratio * eta_;
      break;
    }
    case Gate::kLoopClosure: report.gate_value = ClosesLoop(update) ? 1 : 0; break;
    case Gate::kAlways:
    case Gate::kNever: break;
  }
  eta_ = 0.5 * log_det;
  eta_variables_ = factor_.Variables();
  switch (options_.gate) {
    case Gate::kLoopClosure: report.gate_open = report.gate_value > 0; break;
    case Gate::kAlways: report.gate_open = true; break;
    case Gate::kNever: report.gate_open = false; break;
    case Gate::kNewtonDecrement:
      // The linear decrease does not see what relinearisation would find.
      report.gate_open = report.gate_value > options_.gate_threshold || deferred_ || IsRelinearizationDue();
      break;
    default:
      // With the gauge's anchor the determinant changes for another reason.
      report.gate_open = report.gate_value > options_.gate_threshold || deferred_ || !plan.changes.replaced.empty();
  }
}

// Carry::kOffset, a closed gate: each new pose goes to the minimum of its factors, everything before it held.
template <class Pose>
void IncrementalSolver<Pose>::PlaceNewPoses(int new_poses, StepReport& report) {
  const int variables = factor_.Variables();
  for (int v = variables - new_poses; v < variables; ++v) {
    Matrix<B, B> H = Matrix<B, B>::Zero();
    Vector<B> b = Vector<B>::Zero();
    for (const int slot : factor_.SlotsOf(v)) {
      const LinearFactor<B>& f = factor_.FactorAt(slot);
      const int other = f.first == v ? f.second : f.first;
      if (other > v) continue;
      const Matrix<B, B>& A = f.first == v ? f.A_first : f.A_second;
      Vector<B> r = f.residual;
      if (other >= 0) {
        r += (f.first == v ? f.A_second : f.A_first) *
             Eigen::Map<const Vector<B>>(factor_.Solution().data() + At(other) * B);
      }
      H += A.transpose() * A;
      b -= A.transpose() * r;
    }
    const Eigen::LLT<Matrix<B, B>> llt(H);
    if (llt.info() != Eigen::Success) continue;  // held by a later pose only: stays where it was composed
    const Vector<B> d = llt.solve(b);
    for (const int slot : factor_.SlotsOf(v)) linear_cost_ -= LinearCost(factor_.FactorAt(slot), factor_.Solution());
    factor_.SetSolution(v, d);
    for (const int slot : factor_.SlotsOf(v)) linear_cost_ += LinearCost(factor_.FactorAt(slot), factor_.Solution());
    ++report.variables_moved;
  }
  report.predicted_decrease -= RemainingDecrease();
}

#define TERSE_INSTANTIATE(Pose)                                                                               \
  template IncrementalSolver<Pose>::GateValues IncrementalSolver<Pose>::ValuesForGate() const;                \
  template void IncrementalSolver<Pose>::ChangeCosts(const LinearFactor<B>&, int);                            \
  template void IncrementalSolver<Pose>::RecountCosts();                                                      \
  template double IncrementalSolver<Pose>::RemainingDecrease() const;                                         \
  template double IncrementalSolver<Pose>::DegreesOfFreedom() const;                                          \
  template void IncrementalSolver<Pose>::DecideGate(const GraphUpdate<Pose>&, const Plan&, const GateValues&, \
                                                    StepReport&);                                             \
  template void IncrementalSolver<Pose>::PlaceNewPoses(int, StepReport&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse
