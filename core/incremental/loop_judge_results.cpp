// What LoopJudge tells of the loops, and batch solves with its kernel.

#include <cmath>
#include <stdexcept>

#include "incremental/loop_judge.h"

namespace terse::internal {

using std::size_t;

template <class Pose>
double LoopJudge<Pose>::RobustChi2(const Map& map) const {
  double sum = map.Chi2();
  const auto replace = [&](FactorId id) {
    const double chi2 = map.Chi2Of(id);
    sum += RobustCost(options_.kernel, chi2, Width()) - chi2;
  };
  for (const Parked& parked : parked_) replace(parked.id);
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (slots_[slot].is_loop) replace(map.IdAt(static_cast<int>(slot)));
  }
  return sum;
}

template <class Pose>
std::vector<double> LoopJudge<Pose>::WeightsIn(const Map& map) const {
  std::vector<double> weights;
  for (const auto& node : map.Graph().Factors()) weights.push_back(map.SlotOf(node.id) >= 0 ? 1 : 0);
  return weights;
}

template <class Pose>
double LoopJudge<Pose>::WeightOf(FactorId id, const Map& map) const {
  if (map.Graph().FindFactor(id) == nullptr) {
    throw std::invalid_argument("factor " + std::to_string(id.value) + " is not in the graph");
  }
  if (!IsActive()) return 1;
  const int slot = map.SlotOf(id);
  if (slot < 0) return 0;
  const OfSlot& known = slots_[static_cast<size_t>(slot)];
  return known.is_loop ? known.weight : 1;
}

template <class Pose>
BatchResult<Pose> LoopJudge<Pose>::SolveBatch(const Map& map, const std::vector<Pose>& T_world_body,
                                              BatchOptions options, bool anew) const {
  if (!IsActive()) return terse::SolveBatch(map.Graph(), T_world_body, options);
  options.robust = options_;
  options.robust.width = Width();
  options.robust_factors.emplace();
  for (const Parked& parked : parked_) options.robust_factors->push_back(parked.id);
  for (size_t slot = 0; slot < slots_.size(); ++slot) {
    if (slots_[slot].is_loop) options.robust_factors->push_back(map.IdAt(static_cast<int>(slot)));
  }
  options.graduate = false;
  if (!Chooses() || parked_.empty()) return terse::SolveBatch(map.Graph(), T_world_body, options);
  if (anew) {
    options.graduate = true;
    options.robust = options_;
    options.robust_factors.reset();
    return terse::SolveBatch(map.Graph(), T_world_body, options);
  }
  // Who is in was decided by innovations: residuals tell the same only at the optimum of those.
  const std::vector<double> weights = WeightsIn(map);
  BatchOptions held = options;
  held.robust = RobustOptions();
  held.robust_factors.reset();
  const BatchResult<Pose> start = terse::SolveBatch(WithWeights(map.Graph(), weights), T_world_body, held);
  const bool is_good = start.termination != Termination::kNotPositiveDefinite;
  return terse::SolveBatch(map.Graph(), is_good ? start.T_world_body : T_world_body, options);
}

// Linear factors keep their points.
template <class Pose>
void LoopJudge<Pose>::TakeWeights(const std::vector<double>& weights, StepContext<Pose>& step) {
  if (!IsActive()) return;
  Loops in, out;
  size_t k = 0;
  for (const auto& node : step.map.Graph().Factors()) {
    const double weight = weights[k++];
    const int slot = step.map.SlotOf(node.id);
    if (slot >= 0 && !At(slot).is_loop) continue;
    if (!Chooses() && slot >= 0) {
      SetWeight(slot, weight, step.map);
      continue;
    }
    if (weight > 0 && slot < 0) in.emplace_back(node.id, step.map);
    if (weight == 0 && slot >= 0) out.emplace_back(node.id, step.map);
  }
  if (!Chooses()) {
    AdmitWeighted(in, step);
    return;
  }
  if (!in.empty() || !out.empty()) Exchange(in, out, step);
}

#define TERSE_INSTANTIATE(Pose)                                                                                    \
  template double LoopJudge<Pose>::RobustChi2(const Map&) const;                                                   \
  template std::vector<double> LoopJudge<Pose>::WeightsIn(const Map&) const;                                       \
  template double LoopJudge<Pose>::WeightOf(FactorId, const Map&) const;                                           \
  template BatchResult<Pose> LoopJudge<Pose>::SolveBatch(const Map&, const std::vector<Pose>&, BatchOptions, bool) \
      const;                                                                                                       \
  template void LoopJudge<Pose>::TakeWeights(const std::vector<double>&, StepContext<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
