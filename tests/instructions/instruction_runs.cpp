// instruction_runs NAME: one run over a generated graph, for check.py to count its instructions. Prints the kernels
// used.

#include <cmath>
#include <iostream>
#include <map>
#include <stdexcept>

#include "terse/compact/compact_graph.h"
#include "terse/core/batch_solver.h"
#include "terse/core/dense_kernels.h"
#include "terse/core/generate.h"
#include "terse/core/initial_values.h"
#include "terse/core/replay.h"
#include "terse/covariance/incremental_marginals.h"

namespace {

using namespace terse;

template <class Pose>
PoseGraph<Pose> Generated(Scene scene, long poses) {
  PoseGraph<Pose> graph;
  GenerateOptions options;
  options.scene = scene;
  options.poses = poses;
  GenerateSink<Pose> sink;
  sink.pose = [&](PoseId id, const Pose& T_world_body) { graph.AddPose(id, T_world_body); };
  sink.edge = [&](const RelativePoseFactor<Pose>& edge) { graph.AddFactor(edge); };
  Generate<Pose>(options, sink);
  return graph;
}

template <class Pose>
void Incremental(Scene scene, long poses) {
  IncrementalSolver<Pose> solver;
  Replay<Pose>(Generated<Pose>(scene, poses), {}, solver);
}

void Batch() {
  const PoseGraph<SE2> graph = Generated<SE2>(Scene::kManhattan, 3000);
  SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose));
}

void Covariances() {
  IncrementalSolver<SE2> solver;
  IncrementalMarginals<SE2> marginals(solver);
  double sum = 0;
  Replay<SE2>(Generated<SE2>(Scene::kManhattan, 400), {}, solver, [&](const ReplayStep&) {
    marginals.Update();
    sum += marginals.KeptMarginals().front().trace() + marginals.NewestColumn().front().trace();
    return true;
  });
  if (!std::isfinite(sum)) throw std::runtime_error("a covariance is not finite");
}

void Compact() { CompactGraph(Generated<SE2>(Scene::kManhattan, 500)); }

}  // namespace

int main(int argc, char** argv) {
  const std::map<std::string, void (*)()> runs = {{"incremental-2d", [] { Incremental<SE2>(Scene::kManhattan, 1200); }},
                                                  {"incremental-3d", [] { Incremental<SE3>(Scene::kSphere, 400); }},
                                                  {"batch", Batch},
                                                  {"covariances", Covariances},
                                                  {"compact", Compact}};
  const auto run = argc == 2 ? runs.find(argv[1]) : runs.end();
  if (run == runs.end()) {
    std::cerr << "usage: instruction_runs NAME, one of:";
    for (const auto& entry : runs) std::cerr << ' ' << entry.first;
    std::cerr << '\n';
    return 2;
  }
  run->second();
  std::cout << internal::Kernels().name << '\n';
}
