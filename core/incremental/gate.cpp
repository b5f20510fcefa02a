#include "incremental/gate.h"

#include <algorithm>
#include <cmath>

#include "terse/core/at.h"
#include "terse/core/definite.h"
#include "terse/core/state_file.h"

namespace terse::internal {
namespace {

using std::size_t;

// ln |H_nn| of the poses from `first_new` on, given all others.
template <int B>
double ConditionalLogDeterminant(const std::vector<LinearFactor<B>>& factors, int first_new, int variables) {
  if (variables == first_new + 1) {  // the usual case
    Matrix<B, B> H = Matrix<B, B>::Zero();
    for (const LinearFactor<B>& f : factors) {
      if (f.first == first_new) H += f.A_first.transpose() * f.A_first;
      if (f.second == first_new) H += f.A_second.transpose() * f.A_second;
    }
    return IsDefinite<B>(H) ? 2 * LowerCholesky<B>(H).diagonal().array().log().sum() : 0;
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

template <class Pose>
bool ClosesLoop(const GraphUpdate<Pose>& update, const LinearizedGraph<Pose>& map, double least_apart) {
  const PoseGraph<Pose>& graph = map.Graph();
  const int old = map.Cholesky().Variables() - static_cast<int>(update.poses.size());
  std::vector<char> is_joined(update.poses.size(), 0);  // the factor that brings a pose in closes nothing
  for (const auto& factor : update.factors) {
    const auto* f = std::get_if<RelativePoseFactor<Pose>>(&factor);
    if (f == nullptr) continue;
    const auto [low, high] = std::minmax({graph.IndexOf(f->from), graph.IndexOf(f->to)});
    if (high >= old && std::exchange(is_joined[At(high - old)], 1) == 0) continue;
    if (high - low > least_apart) return true;
  }
  return false;
}

}  // namespace

template <class Pose>
void UpdateGate<Pose>::Decide(const News& news, StepContext<Pose>& step) {
  const LinearizedGraph<Pose>& map = step.map;
  const IncrementalOptions& options = step.options;
  StepReport& report = step.report;
  const double log_det = map.Cholesky().LogDeterminant();
  const int variables = map.Cholesky().Variables();
  if (news.before.variables > 0) {
    const double conditional = news.update.poses.empty() ? 0
                                                         : ConditionalLogDeterminant(news.plan.changes.added,
                                                                                     news.before.variables, variables);
    report.gain_nats = 0.5 * (log_det - news.before.log_determinant - conditional);
  }
  const double remaining = map.RemainingDecrease() + step.settled;
  report.predicted_decrease = remaining;
  switch (options.gate) {
    case Gate::kNewtonDecrement: {
      double unit = 1;
      if (options.decrease_scale == DecreaseScale::kChi2) unit = map.CostUnit();
      if (options.decrease_scale == DecreaseScale::kDof) unit = map.DegreesOfFreedom();
      report.gate_value = remaining / unit;
      break;
    }
    case Gate::kMutualInformation: report.gate_value = report.gain_nats; break;
    case Gate::kLogDeterminant: {
      // eta_{t-1} as it was before the iterations of the previous step.
      if (eta_variables_ == 0) break;
      const double ratio = static_cast<double>(variables) / static_cast<double>(eta_variables_);
      report.gate_value = 0.5 * log_det - ratio * eta_;
      break;
    }
    case Gate::kLoopClosure: report.gate_value = ClosesLoop(news.update, map, options.gate_threshold) ? 1 : 0; break;
    case Gate::kAlways:
    case Gate::kNever: break;
  }
  eta_ = 0.5 * log_det;
  eta_variables_ = variables;
  switch (options.gate) {
    case Gate::kLoopClosure: report.gate_open = report.gate_value > 0; break;
    case Gate::kAlways: report.gate_open = true; break;
    case Gate::kNever: report.gate_open = false; break;
    case Gate::kNewtonDecrement:
      // The linear decrease does not see what relinearisation would find.
      report.gate_open =
          report.gate_value > options.gate_threshold || news.is_deferred || step.relinearization.IsDue(map, options);
      break;
    case Gate::kMutualInformation:
    case Gate::kLogDeterminant:
      // With the gauge's anchor the determinant changes for another reason.
      report.gate_open =
          report.gate_value > options.gate_threshold || news.is_deferred || !news.plan.changes.replaced.empty();
  }
}

template <class Pose>
template <class Archive>
void UpdateGate<Pose>::Serialize(Archive& archive) {
  auto& [eta, eta_variables] = *this;
  archive(eta, eta_variables);
}

#define TERSE_INSTANTIATE(Pose)                                         \
  template class UpdateGate<Pose>;                                      \
  template void UpdateGate<Pose>::Serialize<StateWriter>(StateWriter&); \
  template void UpdateGate<Pose>::Serialize<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
