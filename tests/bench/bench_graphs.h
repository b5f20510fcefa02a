#pragma once
// The graphs that the benchmarks run over: the public ones in ../shared/data, where present, and generated ones.

#include <functional>
#include <string>
#include <vector>

#include "terse/core/graph_file.h"
#include "terse/core/initial_values.h"

namespace terse::bench {

struct BenchGraph {
  std::string name;
  InitialValues start = InitialValues::kCompose;  // of batch optimisation; incremental runs compose
  std::function<AnyPoseGraph()> load;
};

// Says on standard error which public graphs are not there.
std::vector<BenchGraph> BenchGraphs();

// A generated 2D world of streets: any number of poses, local loops.
PoseGraph<SE2> GeneratedManhattan(long poses);

}  // namespace terse::bench
