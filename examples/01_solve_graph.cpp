// Reads a pose graph, optimises it and writes it back.
//
//     01_solve_graph [GRAPH [SOLVED.g2o]]      default: data/ellipse.g2o

#include <terse/core/batch_solver.h>
#include <terse/core/graph_file.h>

#include <cstdio>
#include <exception>
#include <string>

using namespace terse;

// The same for planar graphs (SE2) and for those in space (SE3).
template <class Pose>
void Solve(const PoseGraph<Pose>& graph, const std::string& output) {
  BatchOptions options;
  options.progress = [](int iteration, double chi2) {
    std::printf("  iteration %d: chi2 %.6g\n", iteration, chi2);
    return true;  // go on
  };
  // The values in a file may be missing or far off: where to start is found by trying.
  const BatchResult<Pose> result = SolveBatch(graph, options);
  std::printf("%s after %d iterations: %zu poses, %zu factors, chi2 %.9g\n", Name(result.termination),
              result.iterations, graph.Poses().size(), graph.Factors().size(), result.chi2);

  if (output.empty()) return;
  WriteG2o(graph.WithPoses(result.T_world_body), output);
  std::printf("wrote %s\n", output.c_str());
}

int main(int argc, char** argv) try {
  const GraphFile file = ReadGraph(argc > 1 ? argv[1] : "data/ellipse.g2o");
  const std::string output = argc > 2 ? argv[2] : "";
  std::visit([&](const auto& graph) { Solve(graph, output); }, file.graph);
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());  // names the file, the line and the cause
  return 1;
}
