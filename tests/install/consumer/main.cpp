// A user of the installed library. Every kind of public type crosses the boundary in both directions, and what one
// side allocates the other frees: that crashes or prints other numbers if the two disagree about a type's layout.
//
// Nine digits: the header's inline functions may use fused multiply-add here and not in the library.

#include <terse/core/pose_graph.h>
#include <terse/core/residual.h>
#include <cstdio>
#include <stdexcept>

using terse::PoseId;
using terse::SE3;

int main() {
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
