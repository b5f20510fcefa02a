#include <terse/compact/compact_graph.h>
#include <terse/core/graph_file.h>
#include <cstdio>

int main(int argc, char** argv) {
  if (argc != 2) {
    std::fprintf(stderr, "usage: %s GRAPH\n", argv[0]);
    return 2;
  }
  const auto graph = terse::ReadPoseGraph<terse::SE3>(argv[1]);  // g2o, TORO or iSAM; errors are exceptions
  const auto run = terse::CompactGraph(graph);                   // thresholds from a sample of the graph
  const terse::IncrementalMarginals<terse::SE3> marginals(run.slam.Solver());
  const terse::PoseId last = run.slam.Solver().Graph().Poses().back().id;
  std::printf("kept %d of %zu poses and %d of %d links\n", run.PosesKept(), graph.Poses().size(), run.LinksKept(),
              run.links_offered);
  std::printf("variance of pose %ld along its x: %.3g m^2\n", static_cast<long>(last.value),
              marginals.Marginal(last)(0, 0));
  terse::WriteG2o(run.KeptGraph(), "compact.g2o");
}
