// A user of the installed library. Every kind of public type crosses the boundary in both directions, and what one
// side allocates the other frees: that crashes or prints other numbers if the two disagree about a type's layout.
//
// Usage: consumer FILE.g2o, where a copy of the graph goes.
//
// Nine digits: the header's inline functions may use fused multiply-add here and not in the library.

#include <terse/compact/graph_replay.h>
#include <terse/core/graph_file.h>
#include <terse/core/incremental_solver.h>
#include <terse/core/initial_values.h>
#include <terse/core/residual.h>
#include <terse/covariance/marginals.h>
#include <cstdio>
#include <stdexcept>

using terse::PoseId;
using terse::SE3;

namespace {

// Four laps of a regular polygon with twelve corners, each corner linked to the next one's place a lap before.
terse::PoseGraph<SE3> Laps() {
  terse::PoseGraph<SE3> graph;
  const SE3 T_step = SE3::Exp((SE3::Tangent() << 1, 0, 0, 0, 0, 3.14159265358979323846 / 6).finished());
  const SE3::Jacobian information = 400 * SE3::Jacobian::Identity();
  for (int i = 0; i < 48; ++i) {
    graph.AddPose(PoseId{i});
    const SE3 T_error = SE3::Exp(SE3::Tangent::Constant(0.01 * (i % 5 - 2)));
    if (i > 0) {
      graph.AddFactor(terse::RelativePoseFactor<SE3>{PoseId{i - 1}, PoseId{i}, T_step * T_error, information});
    }
    if (i >= 11)
      graph.AddFactor(terse::RelativePoseFactor<SE3>{PoseId{i - 11}, PoseId{i}, T_step.Inverse(), information});
  }
  return graph;
}

void SolveAndCompact(const char* path) {
  const terse::PoseGraph<SE3> graph = Laps();
  // The library allocates these poses, this program appends one more, drops it, and hands them back.
  std::vector<SE3> initial = terse::ComputeInitialValues(graph, terse::InitialValues::kCompose);
  initial.push_back(initial.back());
  initial.pop_back();
  const terse::BatchResult<SE3> solved = terse::SolveBatch(graph, initial);
  std::printf("solve: %s, chi2 %.9g, ln det H %.9g\n", terse::Name(solved.termination), solved.chi2,
              solved.log_determinant);

  // The library allocates the matrix, this program replaces it by a larger one and frees both.
  const terse::Marginals<SE3> marginals(graph, solved);
  terse::MatrixX joint = marginals.Joint({PoseId{5}, PoseId{20}});
  std::printf("joint %ld, trace %.9g\n", static_cast<long>(joint.rows()), joint.trace());
  joint = marginals.Joint({PoseId{1}, PoseId{2}, PoseId{3}});
  joint.conservativeResize(24, 24);
  std::printf("covariances %zu, relative %.9g\n", marginals.AllMarginals().size(),
              marginals.Relative(PoseId{0}, PoseId{30}).trace());

  terse::IncrementalSolver<SE3> incremental;
  terse::GraphUpdate<SE3> update;
  for (const auto& node : graph.Poses()) update.poses.push_back({node.id});
  for (const auto& node : graph.Factors()) update.factors.push_back(node.factor);
  std::printf("incremental: %zu factors\n", incremental.Update(update).factor_ids.size());
  std::vector<SE3> estimates = incremental.Estimates();
  estimates.resize(500, estimates.front());
  std::printf("after Finish: chi2 %.9g\n", incremental.Finish().chi2);

  // The registration is this program's function, called by the library.
  terse::GraphReplay<SE3> replay(graph);
  const terse::Registration<SE3> edges = replay.AsRegistration();
  int calls = 0;
  const terse::Registration<SE3> counted = [&](PoseId candidate, PoseId current) {
    ++calls;
    return edges(candidate, current);
  };
  terse::CompactOptions<SE3> options;
  options.thresholds.range = replay.LinkRange();
  options.thresholds.link_covariance = replay.LinkCovariance();
  terse::CompactPoseSlam<SE3> slam(options);
  std::vector<terse::Decision> decisions;
  for (terse::CompactInput<SE3> input : replay.Inputs()) {
    input.loops.reset();  // to be registered
    decisions.push_back(slam.AddPose(input, counted));
  }
  std::printf("compact: last %s, %zu of %d poses, %d links, %d calls\n", terse::Name(decisions.back().verdict),
              slam.Solver().Graph().Poses().size(), slam.PosesSeen(), slam.LinksKept(), calls);
  std::printf("recovered %zu, the last %.9g m from the origin\n", slam.Trajectory().size(),
              slam.Trajectory().back().T_world_body.Translation().norm());
  const auto map = slam.Export();  // the map's type comes with the class
  std::printf("exported %zu poses, %zu edges\n", map.poses.size(), map.edges.size());
  terse::WriteG2o(graph, path);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  SolveAndCompact(argv[1]);

  // The library allocates the graph's vectors of SE3 and information matrices; this program frees them.
  terse::PoseGraph<SE3> graph;
  SE3 T_world_body;
  const SE3 T_step = SE3::Exp((SE3::Tangent() << 1, 0.2, -0.1, 0.05, -0.1, 0.3).finished());
  for (int i = 0; i < 100; ++i) {
    graph.AddPose(PoseId{i}, T_world_body);
    T_world_body = T_world_body * T_step * SE3::Exp(SE3::Tangent::Constant(1e-3 * i));
  }
  SE3::Jacobian information = 2 * SE3::Jacobian::Identity();
  information(0, 5) = information(5, 0) = 0.5;
  for (int i = 1; i < 100; ++i) {
    graph.AddFactor(terse::RelativePoseFactor<SE3>{PoseId{i - 1}, PoseId{i}, T_step, information});
  }
  graph.AddFactor(terse::PosePriorFactor<SE3>{PoseId{0}, SE3(), information});
  std::printf("chi2 %.9g\n", terse::Chi2(graph));

  const std::vector<std::vector<int>> components = terse::ConnectedComponents(graph);
  std::printf("components %zu of %zu\n", components.size(), components.at(0).size());

  const terse::RelativeResidual<SE3> relative = terse::EvaluateRelative(T_step, SE3(), T_world_body);
  std::printf("residual %.9g, Jacobians %.9g %.9g\n", relative.residual.norm(), relative.J_residual_from.norm(),
              relative.J_residual_to.norm());

  // This program grows what the library allocated, and the library reads it.
  terse::PoseGraph<SE3> copy = graph;
  copy.AddPose(PoseId{1000}, T_world_body);
  graph = std::move(copy);
  std::vector<terse::PoseGraph<SE3>::PoseNode> poses = graph.Poses();
  poses.resize(1000, poses.back());
  std::printf("translation of the last %.9g\n", poses.back().T_world_body->Translation().norm());

  try {
    graph.AddFactor(terse::PosePriorFactor<SE3>{PoseId{5}, SE3(), -information});
  } catch (const std::invalid_argument& error) {
    std::printf("refused: %s\n", error.what());
  }
}
