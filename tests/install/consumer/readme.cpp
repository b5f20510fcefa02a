#include <terse/compact/thresholds.h>
#include <terse/core/graph_file.h>
#include <terse/core/initial_values.h>
#include <terse/covariance/marginals.h>
#include <cstdio>

using namespace terse;

int main(int, char** argv) {
  const auto graph = std::get<PoseGraph<SE3>>(ReadGraph(argv[1]).graph);  // a 3D graph; errors are exceptions
  const auto solved = SolveBatch(graph, ComputeInitialValues(graph, InitialValues::kCompose));
  const Marginals<SE3> marginals(graph, solved.T_world_body, solved.factor);
  const PoseId last = graph.Poses().back().id;
  std::printf("chi2 %.6g, variance of the last x %.6g m^2\n", solved.chi2, marginals.Marginal(last)(0, 0));

  GraphReplay<SE3> replay(graph);  // the poses in order of arrival; the edges stand in for the registration
  const Thresholds<SE3> thresholds = SelectThresholds(graph);  // from the first 60 % of the poses
  CompactOptions<SE3> options;
  options.range = thresholds.range;
  options.min_loop_gain = thresholds.min_loop_gain;
  options.min_pose_gain = thresholds.min_pose_gain;
  options.link_covariance = replay.LinkCovariance();
  CompactPoseSlam<SE3> slam(options);
  for (const auto& input : replay.Inputs()) slam.AddPose(input, replay.AsRegistration());
  std::printf("kept %zu of %d poses, %d links\n", slam.Solver().Graph().Poses().size(), slam.PosesSeen(),
              slam.LinksKept());
}
