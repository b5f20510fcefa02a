#include <algorithm>
#include <chrono>

#include "bench_runs.h"
#include "ceres_batch.h"
#include "terse/core/batch_solver.h"

namespace terse::bench {
namespace {

// As for Ceres: until the target, without making the problem's values.
template <class Pose>
TimeToCost TerseTimeToCost(const PoseGraph<Pose>& graph, const std::vector<Pose>& start, double target_chi2,
                           PhaseSeconds& phases) {
  const auto began = std::chrono::steady_clock::now();
  TimeToCost result;
  BatchOptions options;
  options.progress = [&](int iteration, double chi2) {
    result.iterations = iteration;
    result.chi2 = chi2;
    if (chi2 > target_chi2) return true;
    result.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - began).count();
    return false;
  };
  phases = SolveBatch(graph, start, options).seconds;
  return result;
}

nlohmann::json ToJson(const TimeToCost& time) {
  return {{"seconds", time.seconds}, {"iterations", time.iterations}, {"chi2", time.chi2}};
}

void KeepFaster(const TimeToCost& time, TimeToCost& best) {
  if (best.iterations == 0 || (time.seconds >= 0 && time.seconds < best.seconds)) best = time;
}

}  // namespace

template <class Pose>
nlohmann::json RunBatch(const PoseGraph<Pose>& graph, InitialValues start, int repeats) {
  const std::vector<Pose> values = ComputeInitialValues(graph, start);
  const auto optimum = SolveBatch(graph, values);
  const double target = optimum.chi2 * (1 + 1e-6) + 1e-12;
  TimeToCost terse, ceres;
  PhaseSeconds phases;
  for (int k = 0; k < repeats; ++k) {
    KeepFaster(TerseTimeToCost(graph, values, target, phases), terse);
    KeepFaster(CeresTimeToCost(graph, values, target), ceres);
  }
  return {
      {"start", start == InitialValues::kChordal ? "chordal" : "compose"},
      {"optimum", optimum.chi2},
      {"converged", optimum.Converged()},
      {"terse", ToJson(terse)},
      {"phases",
       {{"order", phases.order}, {"linearise", phases.linearise}, {"factor", phases.factor}, {"solve", phases.solve}}},
      {"ceres", ToJson(ceres)}};
}

template nlohmann::json RunBatch<SE2>(const PoseGraph<SE2>&, InitialValues, int);
template nlohmann::json RunBatch<SE3>(const PoseGraph<SE3>&, InitialValues, int);

}  // namespace terse::bench
