// Kernels that weigh every loop: what LoopJudge makes of all but kGnc.

#include <algorithm>
#include <cmath>
#include <vector>

#include "incremental/loop_judge.h"
#include "terse/core/definite.h"

namespace terse::internal {
namespace {

using std::size_t;

// Until the weight on arrival agrees with the residual that it leads to.
constexpr int kMostWeightings = 20;

template <class Pose>
double ToleratedByWeights(const StepContext<Pose>& step) {
  return step.options.reweigh_tolerance * step.map.CostUnit();
}

}  // namespace

// The weight that agrees with the residual that it leads to, found from that of the innovation; 0 if the loop would
// lower the cost by no more than is tolerated: in the factor it would be fill for nothing.
template <class Pose>
double LoopJudge<Pose>::WeightOnArrival(Loop& loop, double tolerated, const Map& map) const {
  const RobustKernel kernel = options_.kernel;
  double weight = RobustWeight(kernel, loop.residual.squaredNorm(), Width());
  if (weight == 1) return weight;
  loop.z = SolveForward(map.Cholesky().Tree(), loop.linear);
  const Matrix<B, B> P = Gram<B>(loop.z, loop.z), I = Matrix<B, B>::Identity();
  weight = RobustWeight(kernel, MahalanobisSquared<B>(I + P, loop.residual), Width());
  Vector<B> r = loop.residual;
  for (int k = 0; k < kMostWeightings; ++k) {
    r = SolveDefinite<B>(I + weight * P, loop.residual);
    weight = RobustWeight(kernel, r.squaredNorm(), Width());
  }
  return weight * loop.residual.dot(loop.residual - r) > tolerated ? weight : 0;
}

template <class Pose>
bool LoopJudge<Pose>::AdmitWeighted(Loops loops, StepContext<Pose>& step) {
  for (Loop& loop : loops) {
    loop.weight = WeightOnArrival(loop, ToleratedByWeights(step), step.map);
    Park(loop.id, step.map.Chi2Of(loop.id));
  }
  loops.erase(std::remove_if(loops.begin(), loops.end(), [](const Loop& loop) { return loop.weight == 0; }),
              loops.end());
  return !loops.empty() && Exchange(loops, {}, step);
}

template <class Pose>
bool LoopJudge<Pose>::ReviewWeights(StepContext<Pose>& step) {
  Map& map = step.map;
  typename Map::Replacements replaced;
  Loops out;
  const auto point = [&](int v) -> const Pose& { return map.Points()[static_cast<size_t>(v)]; };
  const double tolerated = ToleratedByWeights(step);
  for (const int slot : TakeTouched(map).loops) {
    const double chi2 = map.Chi2Of(map.IdAt(slot)), weight = RobustWeight(options_.kernel, chi2, Width());
    if (chi2 > limit_ && weight * chi2 <= tolerated) {
      out.emplace_back(map.IdAt(slot), map);
      continue;
    }
    if (std::abs(weight - At(slot).weight) * chi2 <= tolerated) continue;
    SetWeight(slot, weight, map);
    replaced.emplace_back(slot, map.LinearizeSlot(slot, point));
  }
  const bool reweighed =
      !replaced.empty() && step.relinearization.MovePoints({}, std::move(replaced), map, step.options, step.report);
  if (out.empty() || !Exchange({}, out, step)) return reweighed;
  for (const Loop& loop : out) Park(loop.id, step.map.Chi2Of(loop.id));
  has_evicted_ = false;
  return true;
}

template <class Pose>
void LoopJudge<Pose>::SetWeight(int slot, double weight, Map& map) {
  At(slot).weight = weight;
  map.SetRoot(slot, std::sqrt(weight) * SquareRootInformation(map.Graph().FindFactor(map.IdAt(slot))->factor));
}

#define TERSE_INSTANTIATE(Pose)                                            \
  template bool LoopJudge<Pose>::AdmitWeighted(Loops, StepContext<Pose>&); \
  template bool LoopJudge<Pose>::ReviewWeights(StepContext<Pose>&);        \
  template void LoopJudge<Pose>::SetWeight(int, double, LinearizedGraph<Pose>&);
TERSE_INSTANTIATE(SE2)
TERSE_INSTANTIATE(SE3)
#undef TERSE_INSTANTIATE

}  // namespace terse::internal
