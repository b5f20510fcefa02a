// Keeps the poses and links of a graph that carry information, and writes what is left: what CompactGraph
// (compact_graph.h) does in one call, step by step.
//
//     03_compact_from_graph [GRAPH [COMPACT.g2o]]      a graph in space; default: data/ellipse.g2o

#include <terse/compact/compact_graph.h>
#include <terse/core/graph_file.h>

#include <cstdio>
#include <exception>

using namespace terse;

int main(int argc, char** argv) try {
  const auto graph = std::get<PoseGraph<SE3>>(ReadGraph(argc > 1 ? argv[1] : "data/ellipse.g2o").graph);

  // How far links reach and how much information is little: from a sample of the graph.
  CompactOptions<SE3> options;
  const Thresholds<SE3> thresholds = SampleThresholds(graph, options).thresholds;
  std::printf("links reach %.1f m; a loop counts from %.2f nats on, a pose from %.2f\n",
              thresholds.range.head<3>().maxCoeff(), thresholds.min_loop_gain, thresholds.min_pose_gain);

  // The file's poses in order of arrival; its loops answer when the run asks for a registration.
  GraphReplay<SE3> replay(graph);
  CompactPoseSlam<SE3> slam(options);
  for (const auto& input : replay.Inputs()) {
    const Decision decision = slam.AddPose(input);
    if (decision.links_accepted == 0) continue;
    std::printf("pose %4ld: %s, %d of %zu candidates linked\n", static_cast<long>(decision.id.value),
                Name(decision.verdict), decision.links_accepted, decision.candidates.size());
  }
  const auto result = slam.Finish();  // to the optimum of what was kept
  const auto& kept = slam.Solver().Graph();
  std::printf("kept %zu of %d poses, %d of %d links; chi2 %.6g\n", kept.Poses().size(), slam.PosesSeen(),
              slam.LinksKept(), replay.LinksOffered(), result.chi2);

  // All poses, the dropped ones between their kept neighbours.
  const auto trajectory = slam.Trajectory();
  const auto end = trajectory.back().T_world_body.Translation();
  std::printf("the last of %zu poses: %.3f %.3f %.3f\n", trajectory.size(), end.x(), end.y(), end.z());

  if (argc > 2) {
    WriteG2o(kept.WithPoses(result.T_world_body), argv[2]);
    std::printf("wrote %s\n", argv[2]);
  }
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
