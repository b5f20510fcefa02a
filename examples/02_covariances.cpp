// How well is each pose known, and how well the displacement between two of them?
//
//     02_covariances [GRAPH]      a graph in space; default: data/ellipse.g2o

#include <terse/core/graph_file.h>
#include <terse/covariance/marginals.h>

#include <cmath>
#include <cstdio>
#include <exception>
#include <utility>

using namespace terse;

int main(int argc, char** argv) try {
  const auto graph = std::get<PoseGraph<SE3>>(ReadGraph(argc > 1 ? argv[1] : "data/ellipse.g2o").graph);
  auto solved = SolveBatch(graph);
  if (!solved.Converged()) std::printf("not converged: %s\n", solved.message.c_str());

  // Of the result's own factor; nothing is factored again.
  const Marginals<SE3> marginals(graph, std::move(solved));

  // 6x6 blocks of T Exp([rho; phi]): metres and radians, in the body frame.
  const auto all = marginals.AllMarginals();
  const auto metres = [](const Matrix<6, 6>& S) { return std::sqrt(S.topLeftCorner<3, 3>().trace()); };
  const auto degrees = [](const Matrix<6, 6>& S) {
    return std::sqrt(S.bottomRightCorner<3, 3>().trace()) * 180 / M_PI;
  };
  for (std::size_t i = 0; i < all.size(); i += (all.size() + 9) / 10) {
    std::printf("pose %4ld: %.3f m, %.2f deg\n", static_cast<long>(graph.Poses()[i].id.value), metres(all[i]),
                degrees(all[i]));
  }

  // Two poses are known relative to each other better than each of them in the world.
  const PoseId first = graph.Poses().front().id, last = graph.Poses().back().id;
  const PoseId middle = graph.Poses()[graph.Poses().size() / 2].id;
  for (const PoseId other : {first, middle}) {
    const auto relative = marginals.Relative(other, last);
    std::printf("pose %ld seen from pose %ld: %.3f m, %.2f deg\n", static_cast<long>(last.value),
                static_cast<long>(other.value), metres(relative), degrees(relative));
  }

  // In the world frame, rotation first, as some other libraries have it.
  const auto world = marginals.Marginal(last, {CovarianceFrame::kWorld, TangentOrder::kRotationFirst});
  std::printf("variance of the last pose's turn about the world's z axis: %.3g rad^2\n", world(2, 2));
} catch (const std::exception& error) {
  std::fprintf(stderr, "%s\n", error.what());
  return 1;
}
