// Benchmarks on the public graphs (where ../shared/data is present) and on generated ones.
//
// Factor: one numeric factorisation of H at the initial values, ours and CHOLMOD's (supernodal, its own ordering), on
// the same matrix. Batch: to convergence. Incremental: one pose per step with all its edges, full estimate
// after each. Covariance: all diagonal blocks at the initial values. One thread. BENCH_ARGS go to Google Benchmark,
// for example --benchmark_filter=Factor or --benchmark_out=results.json.

#include <benchmark/benchmark.h>
#include <cholmod.h>

#include <filesystem>
#include <functional>
#include <memory>

#include "terse/core/generate.h"
#include "terse/core/graph_file.h"
#include "terse/core/initial_values.h"
#include "terse/core/replay.h"
#include "terse/covariance/selected_inverse.h"
#include "testing.h"

namespace terse {
namespace {

// H in compressed columns, lower triangle.
template <class Pose>
class CholmodMatrix {
 public:
  static constexpr int B = Pose::kDof;

  CholmodMatrix(const PoseGraph<Pose>& graph, const std::vector<Pose>& values) {
    cholmod_start(&common_);
    common_.supernodal = CHOLMOD_SUPERNODAL;
    const std::size_t n = B * values.size();
    std::vector<LinearFactor<B>> factors;
    for (const auto& node : graph.Factors()) {
      const FactorPoses ends = PosesOf(node.factor);
      const int i = graph.IndexOf(ends.first), j = graph.IndexOf(ends.second);
      factors.push_back(
          Linearize(node.factor, i, j, values[static_cast<std::size_t>(i)], values[static_cast<std::size_t>(j)]));
    }
    factors.push_back(Anchor<B>(0, AnchorInformation<Pose>(CountAbsoluteFactors(graph))));
    cholmod_triplet* triplets = cholmod_allocate_triplet(n, n, factors.size() * 3 * B * B, -1, CHOLMOD_REAL, &common_);
    const auto add = [&](int i, int j, const Matrix<B, B>& H) {
      for (int c = 0; c < B; ++c) {
        for (int r = 0; r < B; ++r) {
          const int row = B * i + r, column = B * j + c;
          if (row < column) continue;
          static_cast<int*>(triplets->i)[triplets->nnz] = row;
          static_cast<int*>(triplets->j)[triplets->nnz] = column;
          static_cast<double*>(triplets->x)[triplets->nnz++] = H(r, c);
        }
      }
    };
    for (const auto& f : factors) {
      add(f.first, f.first, f.A_first.transpose() * f.A_first);
      if (f.second < 0) continue;
      add(f.second, f.second, f.A_second.transpose() * f.A_second);
      const bool forward = f.first > f.second;
      const Matrix<B, B> across =
          forward ? Matrix<B, B>(f.A_first.transpose() * f.A_second) : Matrix<B, B>(f.A_second.transpose() * f.A_first);
      add(forward ? f.first : f.second, forward ? f.second : f.first, across);
    }
    matrix_ = cholmod_triplet_to_sparse(triplets, 0, &common_);
    cholmod_free_triplet(&triplets, &common_);
    factor_ = cholmod_analyze(matrix_, &common_);
  }
  ~CholmodMatrix() {
    cholmod_free_factor(&factor_, &common_);
    cholmod_free_sparse(&matrix_, &common_);
    cholmod_finish(&common_);
  }
  CholmodMatrix(const CholmodMatrix&) = delete;
  CholmodMatrix& operator=(const CholmodMatrix&) = delete;

  void Factorize() { cholmod_factorize(matrix_, factor_, &common_); }

 private:
  cholmod_common common_{};
  cholmod_sparse* matrix_ = nullptr;
  cholmod_factor* factor_ = nullptr;
};

template <class Pose>
void RegisterGraph(const std::string& name, std::shared_ptr<const PoseGraph<Pose>> graph, InitialValues initial) {
  const auto values = std::make_shared<const std::vector<Pose>>(ComputeInitialValues(*graph, initial));
  const auto add = [&](const std::string& what, std::function<void(benchmark::State&)> run) {
    benchmark::RegisterBenchmark((what + "/" + name).c_str(), std::move(run))->Unit(benchmark::kMillisecond);
  };
  add("Factor/terse", [=](benchmark::State& state) {
    auto factor = FactorAt(*graph, *values);
    for (auto _ : state) benchmark::DoNotOptimize(factor.Refactor());
  });
  add("Factor/cholmod", [=](benchmark::State& state) {
    CholmodMatrix<Pose> matrix(*graph, *values);
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
    for (auto _ : state) {
      IncrementalSolver<Pose> solver;
      Replay<Pose>(*graph, {}, solver);
      state.counters["chi2"] = solver.Chi2();
    }
  });
  add("Covariance/terse", [=](benchmark::State& state) {
    const auto factor = FactorAt(*graph, *values);
    const SelectedInverse<Pose::kDof> inverse(factor);
    for (auto _ : state) benchmark::DoNotOptimize(inverse.AllDiagonals());
  });
}

void RegisterFile(const std::string& name, const std::string& path, InitialValues initial,
                  RotationInformation meaning) {
  const std::string full = TERSE_SOURCE_DIR "/../shared/data/graphs/" + path;
  if (!std::filesystem::exists(full)) {
    std::fprintf(stderr, "%s: left out, %s is not there\n", name.c_str(), full.c_str());
    return;
  }
  ReadOptions options;
  options.rotation_information = meaning;
  std::visit(
      [&](auto graph) {
        using Graph = decltype(graph);
        RegisterGraph(name, std::make_shared<const Graph>(std::move(graph)), initial);
      },
      ReadGraph(full, options).graph);
}

void RegisterManhattan(long poses) {
  auto graph = std::make_shared<PoseGraph<SE2>>();
  GenerateOptions options;
  options.scene = Scene::kManhattan;
  options.poses = poses;
  GenerateSink<SE2> sink;
  sink.pose = [&](PoseId id, const SE2&) { graph->AddPose(id); };
  sink.edge = [&](const RelativePoseFactor<SE2>& edge) { graph->AddFactor(edge); };
  Generate<SE2>(options, sink);
  RegisterGraph<SE2>("generated_manhattan_" + std::to_string(poses), graph, InitialValues::kChordal);
}

}  // namespace
}  // namespace terse

int main(int argc, char** argv) {
  using terse::InitialValues;
  using terse::RotationInformation;
  const auto quaternion = RotationInformation::kQuaternion, radians = RotationInformation::kRadians;
  terse::RegisterFile("parking-garage", "3d/parking-garage.g2o", InitialValues::kCompose, quaternion);
  terse::RegisterFile("sphere2500", "3d/sphere2500.g2o", InitialValues::kCompose, quaternion);
  terse::RegisterFile("torus3D", "3d/torus3D.g2o", InitialValues::kChordal, radians);
  terse::RegisterFile("kitti00_all_loops", "3d/kitti00_all_loops.g2o", InitialValues::kCompose, quaternion);
  terse::RegisterFile("manhattan", "2d/manhattan.g2o", InitialValues::kCompose, quaternion);
  terse::RegisterFile("city10000", "2d/city10000.g2o", InitialValues::kChordal, quaternion);
  terse::RegisterFile("w10000_hogman", "2d/w10000_hogman.graph", InitialValues::kFile, quaternion);
  terse::RegisterManhattan(10000);
  benchmark::Initialize(&argc, argv);
  if (benchmark::ReportUnrecognizedArguments(argc, argv)) return 2;
  benchmark::RunSpecifiedBenchmarks();
  benchmark::Shutdown();
  return 0;
}
