#include "incremental/minimum_watch.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "terse/core/error.h"
#include "terse/core/initial_values.h"
#include "terse/core/log_message.h"
#include "terse/core/residual.h"
#include "terse/core/state_file.h"

namespace terse::internal {
namespace {

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

// In the frame of the estimate where no measurement gives one. Absent if the relaxation cannot be made.
template <class Pose>
std::optional<std::vector<Pose>> RelaxedValues(const PoseGraph<Pose>& graph, const LinearizedGraph<Pose>& map) {
  try {
    std::vector<Pose> values = ComputeInitialValues(graph, InitialValues::kChordal);
    if (map.Frame().absolute.Count() == 0) {
      const Pose T_new_old = map.EstimateAt(0) * values[0].Inverse();
      for (Pose& value : values) value = T_new_old * value;
    }
    return values;
  } catch (const NumericalError&) {
    return std::nullopt;
  } catch (const std::invalid_argument&) {  // not connected: held by priors in parts
    return std::nullopt;
  }
}

}  // namespace

template <class Pose>
void MinimumWatch<Pose>::NoteStep(double before, double after, const Map& map, const IncrementalOptions& options) {
  explained_ += after - before;
  corrected_ += std::abs(map.MinimumCost() - after);
  if (!options.log) return;
  Log(options.log, LogLevel::kDebug, "step ", map.Updates(), ": chi2 ", map.MinimumCost(), ", the innovations explain ",
      explained_, ", corrected by ", corrected_);
}

template <class Pose>
bool MinimumWatch<Pose>::SeemsTrapped(const Map& map) const {
  const double cost = map.MinimumCost();
  if (!(cost > kRounding * map.DegreesOfFreedom())) return false;
  const auto poses = static_cast<double>(map.Graph().Poses().size());
  const auto factors = static_cast<double>(map.Graph().Factors().size());
  if (factors < poses - 1 + kLeastLoops) return false;
  if (poses < kGrowth * static_cast<double>(poses_tried_) && cost < kGrowth * cost_tried_) return false;
  return cost > kBeyond * std::max(explained_, 0.0) || corrected_ > kCorrected * cost;
}

template <class Pose>
void MinimumWatch<Pose>::NoteTried(const Map& map) {
  cost_tried_ = map.MinimumCost();
  poses_tried_ = static_cast<long>(map.Graph().Poses().size());
}

template <class Pose>
bool MinimumWatch<Pose>::IsSuspected(const Map& map) const {
  return restarts_ > 0 || corrected_ > kCorrectedAtFinish * map.MinimumCost();
}

template <class Pose>
void MinimumWatch<Pose>::NoteRestart(const Map& map) {
  ++restarts_;
  cost_tried_ = map.MinimumCost();
  corrected_ = 0;
  explained_ = std::max(explained_, map.MinimumCost());
}

template <class Pose>
std::optional<BatchResult<Pose>> MinimumWatch<Pose>::LowerMinimum(double cost, bool suspected,
                                                                  const PoseGraph<Pose>& graph, const Map& map,
                                                                  BatchOptions options) const {
  const auto values = RelaxedValues(graph, map);
  if (!values || (!suspected && !(Chi2At(graph, *values) < cost))) return std::nullopt;
  options.max_iterations = kMostIterations;
  options.relative_tolerance = 1e-6;
  BatchResult<Pose> result = SolveBatch(graph, *values, options);
  if (!result.Converged() && result.termination != Termination::kMaxIterations) return std::nullopt;
  if (!(result.chi2 < kLower * cost)) return std::nullopt;
  return result;
}

template <class Pose>
template <class Archive>
void MinimumWatch<Pose>::Serialize(Archive& archive) {
  auto& [explained, corrected, cost_tried, poses_tried, restarts] = *this;
  archive(explained, corrected, cost_tried, poses_tried, restarts);
}

#define TERSE_INSTANTIATE(Pose)                                           \
  template class MinimumWatch<Pose>;                                      \
  template void MinimumWatch<Pose>::Serialize<StateWriter>(StateWriter&); \
  template void MinimumWatch<Pose>::Serialize<StateReader>(StateReader&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
