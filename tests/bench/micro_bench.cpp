// Single operations on the benchmark graphs.
//
// Factor: one numeric factorisation of H at the initial values, ours and CHOLMOD's (supernodal, its own ordering), on
// the same matrix. Batch: to convergence. Incremental: one pose per step with all its edges. Covariance: all diagonal
// blocks at the initial values. One thread. BENCH_ARGS go to Google Benchmark, for example --benchmark_filter=Factor
// or --benchmark_out=results.json.

#include <benchmark/benchmark.h>

#include <functional>
#include <memory>

#include "bench_graphs.h"
#include "cholmod_matrix.h"
#include "terse/core/arrival.h"
#include "terse/core/incremental_solver.h"
#include "terse/covariance/selected_inverse.h"

namespace terse {
namespace {

template <class Pose>
void RegisterGraph(const std::string& name, std::shared_ptr<const PoseGraph<Pose>> graph, InitialValues initial) {
  const auto values = std::make_shared<const std::vector<Pose>>(ComputeInitialValues(*graph, initial));
  const auto add = [&](const std::string& what, std::function<void(benchmark::State&)> run) {
    benchmark::RegisterBenchmark((what + "/" + name).c_str(), std::move(run))->Unit(benchmark::kMillisecond);
  };
  add("Factor/terse", [=](benchmark::State& state) {
    auto factor = CholeskyAt(*graph, *values);
    for (auto _ : state) benchmark::DoNotOptimize(factor.Refactor());
  });
  add("Factor/cholmod", [=](benchmark::State& state) {
    bench::CholmodMatrix<Pose> matrix(*graph, *values);
    matrix.Analyze();
    for (auto _ : state) matrix.Factorize();
  });
  add("Batch/terse", [=](benchmark::State& state) {
    for (auto _ : state) {
      const auto result = SolveBatch(*graph, *values);
      state.counters["chi2"] = result.chi2;
      state.counters["iterations"] = result.iterations;
    }
  });
  add("Incremental/terse", [=](benchmark::State& state) {
    const auto steps = ArrivalSteps(*graph, ArrivalUnit::kPose);
    for (auto _ : state) {
      IncrementalSolver<Pose> solver;
      for (const ArrivalStep& step : steps) {
        GraphUpdate<Pose> update;
        for (const int p : step.poses) update.poses.push_back({graph->Poses()[static_cast<std::size_t>(p)].id});
        for (const int f : step.factors) update.factors.push_back(graph->Factors()[static_cast<std::size_t>(f)].factor);
        solver.Update(update);
      }
      state.counters["chi2"] = solver.Chi2();
    }
  });
  add("Covariance/terse", [=](benchmark::State& state) {
    const auto factor = CholeskyAt(*graph, *values);
    const SelectedInverse<Pose::kDof> inverse(factor);
    for (auto _ : state) benchmark::DoNotOptimize(inverse.AllDiagonals());
  });
}

}  // namespace
}  // namespace terse

int main(int argc, char** argv) {
  for (const auto& source : terse::bench::BenchGraphs()) {
    std::visit(
        [&](auto graph) {
          using Graph = decltype(graph);
          terse::RegisterGraph(source.name, std::make_shared<const Graph>(std::move(graph)), source.start);
        },
        source.load());
  }
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
