#pragma once
// A planar walk with few, far loops and much noise in the turns: what ends in wrong minima.

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <utility>
#include <vector>

#include "terse/core/pose_graph.h"

namespace terse::testing {

struct WalkOptions {
  unsigned seed = 1;
  int poses = 1000;  // a metre apart; every fifth may turn by 90 degrees
  double radians_per_step = 0.1;
  int loops = 15;    // between poses at the same place, more than a fifth of the walk apart
  double scale = 1;  // of the information alone
};

inline PoseGraph<SE2> NoisyWalk(const WalkOptions& options) {
  constexpr double kMetres = 0.05, kLoopRadians = 0.02;
  std::mt19937_64 engine(options.seed);
  const auto uniform = [&] { return std::uniform_real_distribution<double>(0, 1)(engine); };
  std::normal_distribution<double> normal;
  std::vector<SE2> T_world(static_cast<std::size_t>(options.poses));
  std::map<std::pair<long, long>, std::vector<std::size_t>> cells;
  for (std::size_t k = 0; k < T_world.size(); ++k) {
    double turn = 0;
    if (k % 5 == 0 && uniform() < 1.0 / 3) turn = (uniform() < 0.5 ? -1 : 1) * std::acos(0.0);
    if (k > 0) T_world[k] = T_world[k - 1] * SE2(Vector<2>(1, 0), turn);
    const Vector<2> t = T_world[k].Translation();
    cells[{std::lround(t.x() / 2), std::lround(t.y() / 2)}].push_back(k);
  }
  PoseGraph<SE2> graph;
  const auto add = [&](std::size_t i, std::size_t j, double radians) {
    const Vector<3> sigmas(kMetres, kMetres, radians);
    Vector<3> noise;
    for (int d = 0; d < 3; ++d) noise[d] = sigmas[d] * normal(engine);
    const Matrix<3, 3> information = (options.scale * sigmas.array().square().inverse()).matrix().asDiagonal();
    graph.AddFactor(RelativePoseFactor<SE2>{{static_cast<long>(i)},
                                            {static_cast<long>(j)},
                                            (T_world[i].Inverse() * T_world[j]).Retract(noise),
                                            information});
  };
  graph.AddPose({0}, SE2());
  for (std::size_t k = 1; k < T_world.size(); ++k) {
    graph.AddPose({static_cast<long>(k)});
    add(k - 1, k, options.radians_per_step);
  }
  std::vector<std::pair<std::size_t, std::size_t>> far;
  for (const auto& [cell, poses] : cells) {
    for (const std::size_t i : poses) {
      for (const std::size_t j : poses) {
        if (j > i + T_world.size() / 5) far.emplace_back(i, j);
      }
    }
  }
  for (int k = 0; k < options.loops && !far.empty(); ++k) {
    const auto at = static_cast<std::size_t>(uniform() * static_cast<double>(far.size()));
    add(far[at].first, far[at].second, kLoopRadians);
    far.erase(far.begin() + static_cast<long>(at));
  }
  return graph;
}

}  // namespace terse::testing
